"""Which laxity trials to add to those measured, so that they tell what is left open."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from identknee.calibrate.problem import Problem, Scaled
from identknee.calibrate.quantity import ParameterQuantity, Quantity, RestrictedQuantity
from identknee.checks.usable_trials import about_offered
from identknee.identify.design import ChosenTrials, straight
from identknee.identify.design import design as choose_trials
from identknee.identify.design_criteria import Candidates, Criterion
from identknee.identify.profile.thresholds import chi2_threshold, f_threshold
from identknee.laxity.candidates import repeated
from identknee.laxity.named_trials import TrialsLike, read_trials
from identknee.laxity.protocol import FLEXION, LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity, write_laxity
from identknee.laxity.zeros import zero_of_more
from identknee.model.candidate_laxity import CandidateLaxity, offered_trials, typical_errors
from identknee.model.quantities import AT, quantity_named
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_COORDINATE, array, declared, derived, entry
from identknee.runs.files import PathLike
from identknee.runs.workers import Workers
from identknee.subject.uncertainty import UncertainLike
from identknee.verbs.answer import Answer
from identknee.verbs.identification import Identification, best_fits, identification
from identknee.verbs.values import BoundsLike, NoiseLike
from identknee.verbs.verb import LaxityLike, Run, SubjectLike, verb

ADVICE = "advised_trials.csv"
GROUP = "design"
STRAIGHT = (
    "Intervals and trials were predicted along straight lines about the best fit: equilibria that "
    "begin at measured poses jump too often for profiles."
)


@declared
class Design(Answer):
    """Laxity trials to add, with what they are predicted to tell and what they achieve."""

    choice: ChosenTrials = entry(
        "The trials to add and their effect on the targets", group=GROUP, is_inline=True
    )
    flexion_deg: Array = array("Flexion of each candidate", "candidate", unit="deg", group=GROUP)
    loads: Array = array(
        "Loads of each candidate",
        *("candidate", "load"),
        unit="N or N m, as the load's name says",
        group=GROUP,
    )
    advised: tuple[str, ...] = entry(
        f"Names of the trials to add, the most helpful first, as in {ADVICE}"
    )
    coordinate_sd: Array | None = array(
        "Stated error of each coordinate of an added trial; missing where the data state none",
        "coordinate",
        unit=OF_COORDINATE,
        group=GROUP,
        default=None,
    )
    zero: str = entry("What coordinates of the data are counted from")
    degrees_of_freedom: int | None = entry(
        "Degrees of freedom of the noise estimated from the fit; null where the noise is stated"
    )

    @property
    def candidates(self) -> Protocol:
        """The trials that were to choose from."""
        return Protocol(
            name="candidates",
            trials=self.choice.names,
            flexion_deg=self.flexion_deg,
            loads=self.loads,
        )

    @property
    def to_measure(self) -> Laxity:
        """The trials to add as a table whose coordinates are blank."""
        chosen, n = list(self.choice.chosen), len(self.advised)
        protocol = Protocol(
            name="advised",
            trials=self.advised,
            flexion_deg=self.flexion_deg[chosen],
            loads=self.loads[chosen],
        )
        return Laxity(
            protocol=protocol,
            coordinates=np.full((n, len(COORDINATES)), np.nan),
            sd=None if self.coordinate_sd is None else np.tile(self.coordinate_sd, (n, 1)),
            zero=zero_of_more(self.zero),
            comments=("Trials advised by identknee design: measure, fill in, append to the data.",),
        )

    @property
    @derived("The trials to add, the most helpful first, each with the loss once it is added")
    def trials(self) -> tuple[dict[str, Any], ...]:
        """The trials to add: name, flexion, loads and loss."""
        return tuple(
            {**self.candidate(i), "loss": float(loss)}
            for i, loss in zip(self.choice.chosen, self.choice.losses[1:], strict=True)
        )

    def candidate(self, place: int) -> dict[str, Any]:
        """Name, flexion and loads of the candidate at `place`."""
        return {
            "trial": self.choice.names[place],
            FLEXION: float(self.flexion_deg[place]),
            **dict(zip(LOADS, self.loads[place].tolist(), strict=True)),
        }


@verb
def design(
    run: Run,
    subject: SubjectLike,
    data: LaxityLike,
    *,
    n_trials: int = 4,
    targets: Sequence[str] | None = None,
    criterion: Criterion = "width",
    candidates: TrialsLike | None = None,
    level: float = 0.95,
    noise: NoiseLike = None,
    uncertain: UncertainLike = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    bounds: BoundsLike = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> Design:
    """Which laxity trials to add to those measured, so that they tell what is left open.

    The advice is verified: the trials are simulated at the best fit, added to the data, and the
    intervals computed again.

    Parameters
    ----------
    subject
        A knee, its folder, or the name of one that comes with identknee.
    data
        Measured laxity, its CSV file, or the name of a subject that comes with one.
    n_trials
        How many trials to add.
    targets
        Whose intervals are to shrink: parameters, ``ACL.tension_N@TRIAL`` or ``varus_deg@TRIAL``;
        the parameters with open intervals if None, or all where none is open.
    criterion
        What is to shrink. ``"width"``: the predicted intervals of the targets; ``"c"``: their
        variances at the best fit; ``"D"``, ``"A"``, ``"E"``: volume, mean and largest axis of the
        confidence ellipsoid of all ligament parameters.
    candidates
        Trials to choose from: a protocol, the name of one, its TOML file, or a laxity table. If
        None: drawer, varus-valgus and rotation tests, compression and pairs of loads at 0 to
        120 deg, and repeats.
    level
        Confidence level of the intervals.
    uncertain
        How well geometry, frames and loads are known, as in
        ``"insertions=2mm,registration=2deg"``, in place of what the subject states; ``"none"`` for
        exactly.
    noise, start, fixed, bounds
        As for `identknee.verbs.identification.identification`.
    out
        Folder for the results and for ``advised_trials.csv``, a table of the trials to fill in;
        nothing is written if None.
    seed
        Seed of all random numbers.
    workers
        Processes to work with, or the address of a dask scheduler; results are the same.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputed
        If no parameters near the start have a prediction in every measured trial.
    """
    asked = None if candidates is None else read_trials(candidates)
    setup = identification(
        run.knee, run.laxity, noise=noise, start=start, fixed=fixed, bounds=bounds
    )
    offered = _offered(setup, asked)
    wanted = [_target(setup, name) for name in targets or ()]
    degrees = setup.degrees_of_freedom
    run.start_clock()
    fits = best_fits(setup, seed=seed, executor=run.executor)
    problem: Problem = setup.problem
    begun: Candidates = offered.begun_at(fits[0].theta)
    about_errors = _about_errors(setup, wanted)
    if about_errors and setup.model.poses is not None:
        problem, begun = straight(problem, fits[0].theta, begun)
        about_errors = (*about_errors, STRAIGHT)
    choice = choose_trials(
        problem,
        fits[0].theta,
        begun,
        n_trials=n_trials,
        targets=wanted,
        criterion=criterion,
        executor=run.executor,
        level=level,
        thresholds=chi2_threshold(level) if degrees is None else f_threshold(level, degrees),
    )
    answer = Design(
        choice=choice,
        flexion_deg=offered.protocol.flexion_deg,
        loads=offered.protocol.loads,
        advised=repeated(choice.trials, setup.laxity.protocol.trials),
        coordinate_sd=None if setup.laxity.sd is None else offered.sd,
        zero=setup.laxity.zero,
        degrees_of_freedom=degrees,
        assumptions=(
            *setup.assumptions,
            *about_errors,
            *about_offered(setup.model),
        ),
        **setup.uncertain_at(fits[0].theta),
        findings=setup.findings_at(fits[0].theta, 2.0 * fits[0].objective, fits),
    )
    if run.out is not None:
        write_laxity(answer.to_measure, run.out / ADVICE)
    return answer


def _about_errors(setup: Identification, targets: Sequence[Quantity]) -> tuple[str, ...]:
    """How stated errors count."""
    n = len(setup.problem.parameters.nuisance_names)
    if not n or not all(isinstance(x, ParameterQuantity) for x in targets):
        return ()
    sentence = (
        f"{n} stated errors were averaged over to first order at the best fit, in the data and in "
        "the trials that may be added, which share them."
    )
    return (sentence,)


def _offered(setup: Identification, asked: Protocol | None) -> CandidateLaxity:
    made = setup.laxity.protocol
    protocol = offered_trials(setup.model, made) if asked is None else asked
    return CandidateLaxity(
        model=setup.model,
        laxity=setup.laxity,
        protocol=protocol,
        sd=typical_errors(_with_errors(setup)),
        free=setup.free,
    )


def _with_errors(setup: Identification) -> Laxity:
    """The data with the errors that the problem takes them to have."""
    if not isinstance(setup.problem, Scaled):
        return setup.laxity
    sd = np.full(setup.laxity.coordinates.shape, np.nan)
    sd[setup.laxity.is_measured] = setup.problem.sd
    return replace(setup.laxity, sd=sd)


def _target(setup: Identification, name: str) -> Quantity:
    if AT not in name:
        setup.free_index(name, "--target")
        return ParameterQuantity(parameters=setup.problem.parameters, name=name)
    return RestrictedQuantity(quantity=quantity_named(setup.model, name), free=setup.free)
