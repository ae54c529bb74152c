"""Which laxity trials to add to those measured, so that they tell what is left open."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Unpack

import numpy as np

from identknee.calibrate.problem import (
    ParameterQuantity,
    Problem,
    Quantity,
    RestrictedQuantity,
    WhitenedResiduals,
    value_at,
)
from identknee.checks.unborne_trials import (
    Bearable,
    UnborneTrial,
    bearable,
    unborne_findings,
)
from identknee.checks.usable_trials import candidate_path_findings
from identknee.identify.design import ChosenTrials, linearised, linearised_candidates
from identknee.identify.design import design as choose_trials
from identknee.identify.design_criteria import (
    CandidateTrials,
    Criterion,
    OfferedTrials,
    SeveralCandidates,
    Step,
)
from identknee.identify.profile.result import chi2_threshold, f_threshold
from identknee.laxity.experiments import INTACT
from identknee.laxity.protocol import FLEXION, LOADS, Protocol, unique_names, zero_of_added_trials
from identknee.laxity.table import COORDINATES, Laxity, TrialsLike, read_trials, write_laxity
from identknee.model.candidate_laxity import (
    CONTACT_SD,
    TENSION_SD,
    CandidateLaxity,
    candidate_forces,
    current_state,
    laxity_after_cuts,
    offered_laxity,
    typical_errors,
    with_state,
)
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import AT, quantity_named
from identknee.runs.declare import OF_COORDINATE, Array, array, declared, derived, entry
from identknee.runs.errors import suggestion
from identknee.runs.words import listed
from identknee.subject.knee import Knee
from identknee.verbs import options
from identknee.verbs.answer import Answer, has_priors
from identknee.verbs.identification import (
    Identification,
    best_fits,
    identification,
    with_noise,
)
from identknee.verbs.options import option, trials_option
from identknee.verbs.values import NoiseLike
from identknee.verbs.verb import Run, verb

ADVICE = "advised_trials.csv"
GROUP = "design"
STRAIGHT = (
    "Intervals and trials were predicted by linearisation about the best fit: equilibria that "
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
    states: tuple[str, ...] = entry(
        "State of the knee in which each of these is to be made; empty where nothing is cut",
        default=(),
    )
    unborne: tuple[UnborneTrial, ...] = entry(
        "Trials and other steps that are not offered, since no knee would bear them", default=()
    )
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
            state=self.states or None,
        )
        return Laxity(
            protocol=protocol,
            coordinates=np.full((n, len(COORDINATES)), np.nan),
            sd=None if self.coordinate_sd is None else np.tile(self.coordinate_sd, (n, 1)),
            zero=zero_of_added_trials(self.zero),
            comments=("Trials advised by identknee design: measure, fill in, append to the data.",),
        )

    @property
    @derived("The trials to add, the most helpful first, each with the loss once it is added")
    def trials(self) -> tuple[dict[str, Any], ...]:
        """The trials to add: name, flexion, loads, loss, and the state where something is cut."""
        states = self.states or (INTACT,) * len(self.choice.chosen)
        return tuple(
            {
                **self.candidate(i),
                "loss": float(loss),
                **({} if state == INTACT else {"state": state}),
            }
            for i, loss, state in zip(
                self.choice.chosen, self.choice.losses[1:], states, strict=True
            )
        )

    def candidate(self, place: int) -> dict[str, Any]:
        """Name, flexion and loads of the candidate at `place`."""
        return {
            "trial": self.choice.names[place],
            FLEXION: float(self.flexion_deg[place]),
            **dict(zip(LOADS, self.loads[place].tolist(), strict=True)),
        }


NONE_BORNE = (
    "no knee would bear any of the candidate trials as they are predicted; give --candidates with "
    "smaller loads"
)
KINDS, NEVER = ("trial", "error", "cut", "force", "contact"), "never"
CostsLike = str | Mapping[str, float | str] | None


@verb
def design(
    run: Run,
    subject: options.Subject,
    data: options.MaybeData = None,
    *,
    protocol: Annotated[
        TrialsLike | None,
        trials_option("Trials that are planned, before there is any {DATA}: {}."),
    ] = None,
    n_trials: Annotated[int, option("Number of trials to add.", least=1)] = 4,
    targets: Annotated[
        Sequence[str] | None,
        option(
            f"The quantity to pin down: a parameter or a prediction. {options.PREDICTIONS} If "
            "not given: the parameters with open intervals, or all if none is open.",
            "--target",
            in_python="A list of names.",
            metavar="NAME",
        ),
    ] = None,
    criterion: Annotated[
        Criterion,
        option(
            "What the new trials should make small. width: the predicted intervals of the targets. "
            "c: their variances at the best fit. D, A, E: volume, mean axis and largest axis of "
            "the confidence ellipsoid of all ligament parameters."
        ),
    ] = "width",
    candidates: Annotated[
        TrialsLike | None,
        trials_option(
            "Trials to choose from: {}. If not given: drawer, varus-valgus and rotation tests, "
            "compression and pairs of loads at 0 to 120 deg, and repeats."
        ),
    ] = None,
    cost: Annotated[
        CostsLike,
        option(
            "What other steps cost beside one more trial, as in cut=5,force=3,contact=8; 1 each "
            "if not given, never for a step that you do not consider. error: a stated error "
            "halved. cut: a structure cut and a trial in that state. force: the tension of a "
            "structure in a trial. contact: the contact forces in a trial.",
            in_python="A text, or numbers by kind of step.",
            metavar="KIND=COST,...",
            typed=str | None,
        ),
    ] = None,
    level: options.Level = 0.95,
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    bounds: options.Bounds = None,
    priors: options.Priors = None,
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> Design:
    """Which laxity trials to add to those measured, so that they tell what is left open.

    The advice is checked: the trials are simulated at the best fit and added to the data, and the
    intervals are computed again. Fill in advised_trials.csv and append it to your data. One more
    trial is compared with other single steps: a stated error halved, a cut, a measured force.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputable
        If no parameters near the start have a prediction in every measured trial.
    """
    asked = None if candidates is None else read_trials(candidates)
    costs = costs_of(cost)
    lost: tuple[str, ...] = ()
    is_made = data is not None
    if data is None:
        data, noise = _planned(subject, protocol, noise), None
        lost = lost_plan_sentence(data)
    elif protocol is not None:
        raise ValueError("--protocol is for trials that are planned; leave it out beside DATA.csv")
    setup = identification(
        subject,
        data,
        noise=noise,
        start=start,
        fixed=fixed,
        bounds=bounds,
        priors=has_priors("design", priors),
    )
    made = setup.laxity.protocol
    state = current_state(made)
    offered_trials = offered_laxity(setup.model, made) if asked is None else asked
    offered = CandidateLaxity(
        model=setup.model,
        laxity=setup.laxity,
        protocol=with_state(offered_trials, state)
        if offered_trials.state is None
        else offered_trials,
        sd=typical_errors(_with_errors(setup)),
        free=setup.free,
    )
    wanted = [_target(setup, name) for name in targets or ()]
    degrees = setup.degrees_of_freedom
    run.start_clock()
    fits = best_fits(setup, seed=seed, executor=run.executor)
    for target in wanted:
        value_at(target, fits[0].theta)
    theta = fits[0].theta
    problem: Problem = setup.problem
    limits = bearable(setup.model, setup.free.expand(theta), is_made=is_made)
    offered, unborne = _borne(offered, limits, theta)
    if not offered.protocol.n:
        raise ValueError(NONE_BORNE)
    begun: CandidateTrials = offered.with_start_poses(theta)
    steps, measured, unborne_steps = _other_steps(offered, state, costs, limits, theta)
    unborne = (*unborne, *unborne_steps)
    about_errors = _marginalisation_sentence(setup, wanted)
    if about_errors and setup.model.poses is not None:
        problem, begun = linearised(problem, theta), linearised_candidates(begun, theta)
        if measured is not None:
            measured = linearised_candidates(measured, theta)
        about_errors = (*about_errors, STRAIGHT)
    choice = choose_trials(
        problem,
        theta,
        OfferedTrials(
            trials=begun,
            steps=steps,
            measured=measured,
            costs={k: x for k, x in costs.items() if x is not None},
        ),
        n_trials=n_trials,
        targets=wanted,
        criterion=criterion,
        executor=run.executor,
        level=level,
        thresholds=chi2_threshold(level) if degrees is None else f_threshold(level, degrees),
    )
    made_in = offered.protocol.state
    answer = Design(
        choice=choice,
        flexion_deg=offered.protocol.flexion_deg,
        loads=offered.protocol.loads,
        advised=unique_names(choice.trials, setup.laxity.protocol.trials),
        coordinate_sd=None if setup.laxity.sd is None else offered.sd,
        zero=setup.laxity.zero,
        degrees_of_freedom=degrees,
        states=() if made_in is None else tuple(made_in[i] for i in choice.chosen),
        unborne=unborne,
        assumptions=(
            *lost,
            *setup.assumptions,
            *about_errors,
            *_step_sentence(steps),
            *candidate_path_findings(setup.model),
        ),
        **setup.uncertain_at(theta),
        findings=(
            *setup.findings_at(theta, 2.0 * fits[0].objective, fits),
            *unborne_findings(unborne),
        ),
    )
    if run.out is not None:
        write_laxity(answer.to_measure, run.out / ADVICE)
    return answer


def costs_of(cost: CostsLike) -> dict[str, float | None]:
    """Cost of each kind of step, None for one that is not considered.

    Raises
    ------
    ValueError
        If a kind is unknown, or a cost is no number above 0.

    Examples
    --------
    >>> costs_of("cut=5,contact=never")
    {'trial': 1.0, 'error': 1.0, 'cut': 5.0, 'force': 1.0, 'contact': None}
    """
    stated: Mapping[str, float | str]
    if cost is None or isinstance(cost, str):
        parts = [x.partition("=") for x in (cost or "").split(",") if x.strip()]
        stated = {name.strip(): value.strip() for name, _, value in parts}
    else:
        stated = cost
    found: dict[str, float | None] = dict.fromkeys(KINDS, 1.0)
    for name, value in stated.items():
        if name not in KINDS:
            raise ValueError(f"--cost {name}: there is no such step. {suggestion(name, KINDS)}")
        try:
            number = None if value == NEVER else float(value)
        except ValueError:
            number = np.nan
        is_needed = name in ("trial", "error")
        if (number is None and is_needed) or (number is not None and not 0.0 < number < np.inf):
            remedy = "a number above 0" if is_needed else f"a number above 0 or {NEVER!r}"
            raise ValueError(f"--cost {name} must be {remedy}, got {value!r}")
        found[name] = number
    return found


def _planned(knee: Knee, protocol: TrialsLike | None, noise: NoiseLike) -> Laxity:
    """Laxity of the subject as it stands under trials that are planned, with the stated noise."""
    if protocol is None:
        raise ValueError("give measured laxity, or --protocol with the trials that are planned")
    if noise is None:
        raise ValueError("planned trials need the noise that is expected: --noise 0.5mm,0.5deg")
    model = LaxityModel(knee=knee, protocol=read_trials(protocol))
    return with_noise(model.simulate(model.parameters.start), noise)


def lost_plan_sentence(planned: Laxity) -> tuple[str, ...]:
    """Which planned trials have no equilibrium of the subject as it stands; none where all have."""
    lost = np.flatnonzero(~planned.is_measured.any(axis=1)).tolist()
    names = [planned.protocol.trials[i] for i in lost]
    if not names:
        return ()
    has = "has" if len(names) == 1 else "have"
    sentence = (
        f"Of the planned trials {listed(names)} {has} no equilibrium of the subject as it stands: "
        "the advice rests on the others."
    )
    return (sentence,)


def _borne(
    offered: CandidateLaxity, limits: Bearable, theta: Array
) -> tuple[CandidateLaxity, tuple[UnborneTrial, ...]]:
    """The candidates that the knee bears at theta, and the others."""
    model = offered.with_start_poses(theta).model.with_protocol(offered.protocol)
    unborne = limits.unborne(model, offered.free.expand(theta))
    gone = {x.trial for x in unborne}
    kept = [i for i, x in enumerate(offered.protocol.trials) if x not in gone]
    return replace(offered, protocol=offered.protocol.select(kept)), unborne


def _other_steps(
    offered: CandidateLaxity,
    state: str,
    costs: Mapping[str, float | None],
    limits: Bearable,
    theta: Array,
) -> tuple[tuple[Step, ...], CandidateTrials | None, tuple[UnborneTrial, ...]]:
    """Steps beside one more trial that are considered, what they would measure, and those unborne.

    What the knee does not bear as it is, it does not bear after a cut either, nor while a force is
    measured: those trials are not among `offered`.
    """
    steps: list[Step] = []
    parts: list[CandidateTrials] = []
    gone: list[UnborneTrial] = []
    if costs["cut"] is not None:
        for after in laxity_after_cuts(offered, state):
            laxity, unborne = _borne(after.laxity, limits, theta)
            gone += unborne
            if not laxity.protocol.n:
                continue
            before = dict(zip(after.laxity.names, after.trials, strict=True))
            parts.append(laxity.with_start_poses(theta))
            steps += [
                Step(name=name, kind="cut", structure=after.ligament, trial=before[name])
                for name in laxity.names
            ]
    if costs["force"] is not None or costs["contact"] is not None:
        forces = candidate_forces(
            offered,
            state,
            has_tensions=costs["force"] is not None,
            has_contact=costs["contact"] is not None,
        )
        parts.append(forces.with_start_poses(theta))
        trials = forces.model.protocol.trials
        steps += [
            Step(
                name=name,
                kind="force" if structure else "contact",
                structure=structure,
                trial=trials[i],
            )
            for name, (i, structure) in zip(forces.names, forces.places, strict=True)
        ]
    return tuple(steps), SeveralCandidates(parts=tuple(parts)) if parts else None, tuple(gone)


def _step_sentence(steps: Sequence[Step]) -> tuple[str, ...]:
    """How well forces are taken to be measured."""
    kinds = {x.kind for x in steps}
    said = [
        f"{what} to {sd:g} N"
        for kind, what, sd in (
            ("force", "tensions of structures", TENSION_SD),
            ("contact", "contact forces", CONTACT_SD),
        )
        if kind in kinds
    ]
    return (
        (f"Forces that may be measured are taken to be known: {', '.join(said)}.",) if said else ()
    )


def _marginalisation_sentence(
    setup: Identification, targets: Sequence[Quantity]
) -> tuple[str, ...]:
    """How stated errors count."""
    n = len(setup.problem.parameters.nuisance_names)
    if not n or not all(isinstance(x, ParameterQuantity) for x in targets):
        return ()
    sentence = (
        f"{n} stated errors were marginalised to first order at the best fit, in the data and in "
        "the trials that may be added, which share them."
    )
    return (sentence,)


def _with_errors(setup: Identification) -> Laxity:
    """The data with the errors that the problem takes them to have."""
    if not isinstance(setup.problem, WhitenedResiduals):
        return setup.laxity
    sd = np.full(setup.laxity.coordinates.shape, np.nan)
    sd[setup.laxity.is_measured] = setup.problem.sd
    return replace(setup.laxity, sd=sd)


def _target(setup: Identification, name: str) -> Quantity:
    if AT not in name:
        setup.free_index(name, "--target")
        return ParameterQuantity(parameters=setup.problem.parameters, name=name)
    return RestrictedQuantity(quantity=quantity_named(setup.model, name), free=setup.free)
