"""The one verb for what a model gets wrong: in data, or before any by a protocol."""

from collections.abc import Sequence
from typing import overload

from identknee.laxity.named_trials import TrialsLike
from identknee.model.effects.effect import Effect
from identknee.runs.files import PathLike
from identknee.runs.workers import Workers
from identknee.subject.uncertainty import UncertainLike
from identknee.verbs.diagnose import diagnose_data
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.isolability import Isolability, isolability
from identknee.verbs.values import NoiseLike
from identknee.verbs.verb import LaxityLike, SubjectLike


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
def diagnose(
    subject: SubjectLike,
    data: LaxityLike | None = None,
    *,
    protocol: TrialsLike | None = None,
    noise: NoiseLike = None,
    uncertain: UncertainLike = None,
    start: str = "subject",
    effects: Sequence[Effect] | None = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> Diagnosis | Isolability:
    """What the model of a subject gets wrong in the data, and which physical cause it has.

    The verdict says whether one cause of the library, several or none explain the misfit, with what
    else would and which trials would tell. In a folder it leaves ``extended``, the subject with the
    causes found, for every other verb. With a protocol instead of data it says which causes such
    trials could show and tell apart, as `identknee.isolability` does.

    Parameters
    ----------
    subject
        A knee, its folder, or the name of one that comes with identknee.
    data
        Measured laxity, its CSV file, or the name of a subject that comes with one.
    protocol
        Instead of data: a protocol, the name of one, its TOML file, or a laxity table.
    noise
        Standard deviations of lengths and angles [mm, deg], in place of those of the data.
    uncertain
        How well geometry, frames and loads are known, as in
        ``"insertions=2mm,registration=2deg"``, in place of what the subject states; ``"none"`` for
        exactly.
    start
        Where one more fit of the model without causes begins: the name of a start or a file;
        ``"subject"`` for none.
    effects
        Candidates; the whole library if None.
    out
        Folder for the results; nothing is written if None.
    seed
        Seed of all random numbers.
    workers
        Without effect: one process does the work.

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
