"""The one verb for what a model gets wrong: in data, or before any by a protocol."""

from collections.abc import Sequence
from typing import Annotated, overload

from identknee.laxity.named_trials import TrialsLike
from identknee.model.effects.effect import Effect
from identknee.runs.files import PathLike
from identknee.subject.uncertainty import UncertainLike
from identknee.verbs.diagnose import diagnose_data
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.isolability import Isolability, isolability
from identknee.verbs.options import (
    Candidates,
    ExtraStart,
    GivenData,
    GivenSubject,
    LaxityLike,
    Noise,
    Out,
    Seed,
    SubjectLike,
    Uncertain,
    Workers,
    documented,
    trials_option,
)
from identknee.verbs.values import NoiseLike


@overload
def diagnose(
    subject: SubjectLike,
    data: LaxityLike,
    *,
    protocol: None = None,
    noise: NoiseLike = None,
    uncertain: UncertainLike = None,
    start: str = "subject",
    effects: Sequence[Effect] | None = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> Diagnosis: ...
@overload
def diagnose(
    subject: SubjectLike,
    data: None = None,
    *,
    protocol: TrialsLike,
    noise: str | tuple[float, float],
    uncertain: UncertainLike = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> Isolability: ...
@documented
def diagnose(
    subject: GivenSubject,
    data: GivenData = None,
    *,
    protocol: Annotated[
        TrialsLike | None,
        trials_option(
            "Instead of DATA.csv: find out what planned trials could show, given --noise. The "
            "trials: {}."
        ),
    ] = None,
    noise: Noise = None,
    uncertain: Uncertain = None,
    start: ExtraStart = "subject",
    effects: Candidates = None,
    out: Out = None,
    seed: Seed = 0,
    workers: Workers = 1,
) -> Diagnosis | Isolability:
    """What the model of a subject gets wrong in the data, and which physical cause it has.

    The verdict is ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED or NOT_TESTABLE. With it come the other
    causes that would fit, and the trials that would tell them apart. The folder extended holds the
    subject with the causes found, for use with every other command. With --protocol instead of
    DATA.csv, it says which causes such trials could show and tell apart.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputed
        If the subject has no prediction in any trial of the protocol.
    """
    if (data is None) == (protocol is None):
        raise ValueError(
            "diagnose needs either DATA.csv or --protocol; give one of the two, for example "
            "identknee diagnose reference --protocol seed63 --noise 0.3mm,0.3deg"
        )
    if data is not None:
        return diagnose_data(
            subject,
            data,
            noise=noise,
            uncertain=uncertain,
            start=start,
            effects=effects,
            out=out,
            seed=seed,
            workers=workers,
        )
    if noise is None or protocol is None:
        raise ValueError("--protocol needs --noise; add for example --noise 0.3mm,0.3deg")
    return isolability(
        subject, protocol, noise, uncertain=uncertain, out=out, seed=seed, workers=workers
    )
