"""Detectable and isolable causes under a protocol, before any data."""

from collections.abc import Mapping
from typing import Annotated, Unpack

from identknee.diagnosis.advice import ROOT, protocol_isolability
from identknee.diagnosis.candidates import Detectability
from identknee.diagnosis.score import LEAST_DISTANCE
from identknee.laxity.table import read_trials
from identknee.runs.declare import Array, array, declared, entry
from identknee.runs.errors import NotComputable
from identknee.verbs import options
from identknee.verbs.answer import Answer
from identknee.verbs.options import option
from identknee.verbs.values import AdvisedTrial, advised, noise_of
from identknee.verbs.verb import Run, verb, warm_up


@declared
class ConfusableCauses:
    """Causes that a protocol cannot distinguish, and the trials that would."""

    effects: tuple[str, ...] = entry("Names of the causes")
    distance: float = entry("Distance of the closest two, in units of noise", unit="1")
    distance_with_advised_trials: float = entry(
        "Distance of the closest two with the advised trials", unit="1"
    )
    advised_trials: tuple[AdvisedTrial, ...] = entry("Trials that would tell them apart")


@declared
class Isolability(Answer):
    """Detectable and isolable causes under a protocol on a subject."""

    protocol: str = entry("Name of the protocol")
    n_trials: int = entry("Its trials with a prediction", unit="1")
    groups: tuple[ConfusableCauses, ...] = entry("Causes that it cannot distinguish")
    look_alikes: Mapping[str, tuple[str, ...]] = entry(
        "What each cause could be taken for, the closest first"
    )
    effects: Mapping[str, Detectability] = entry(
        "Which size of each cause it would show", rows="effect", group="isolability"
    )
    rivals: tuple[str, ...] = array(
        "Names of the causes fitted in place of the true one", "rival", is_in_arrays=False
    )
    distances: Array = array(
        "Distance of each cause, if true, from each other one, in units of noise",
        *("effect", "rival"),
        key="distance",
        group="isolability",
    )
    root_noncentrality: float = entry("How far each stands out of the noise", unit="1")
    least_distance: float = entry(
        "Distance from which two causes can be distinguished, in units of noise", unit="1"
    )


@verb
def isolability(
    run: Run,
    subject: options.Subject,
    protocol: options.ProtocolName,
    noise: Annotated[
        str | float | tuple[float, float],
        option(
            "Standard deviations of lengths and angles, such as 0.5mm,0.5deg.",
            in_python="A text, two numbers in mm and deg, or one number for both.",
        ),
    ],
    *,
    seed: options.Seed = 0,
    **_: Unpack[options.KneeOptions],
) -> Isolability:
    """Detectable and isolable causes under a protocol on a subject.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputable
        If the subject has no prediction in any trial.
    """
    trials = read_trials(protocol)
    mm, deg = noise_of(noise)
    warm_up(subject, trials)
    run.start_clock()
    found = protocol_isolability(subject, trials, sd_mm=mm, sd_deg=deg, seed=seed)
    if found is None:
        raise NotComputable(
            "the subject's own values have no prediction in any trial of the protocol. See: "
            f"identknee subject check {subject.name}"
        )
    order = [found.distances.rivals.index(x) for x in found.distances.effects]
    lost = trials.n - found.protocol.n
    said = (
        f"{lost} of the {trials.n} trials of {trials.name} have no prediction at the subject's own "
        f"values and were left out. See: identknee subject check {subject.name}"
    )
    return Isolability(
        assumptions=(said,) if lost else (),
        protocol=found.protocol.name,
        n_trials=found.protocol.n,
        groups=tuple(
            ConfusableCauses(
                effects=x.names,
                distance=x.before,
                distance_with_advised_trials=x.after,
                advised_trials=advised(x.trials),
            )
            for x in found.advice
        ),
        look_alikes=found.look_alikes,
        effects={x.name: x for x in found.visibility},
        rivals=found.distances.effects,
        distances=found.distances.values[:, order],
        root_noncentrality=ROOT,
        least_distance=LEAST_DISTANCE,
    )
