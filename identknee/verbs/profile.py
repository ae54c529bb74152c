"""Which values of each parameter, or of any prediction, the data allow."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from identknee.calibrate.quantity import ParameterQuantity, Quantity, RestrictedQuantity
from identknee.identify.profile.pairs import PairProfile, profile_pair
from identknee.identify.profile.profile import profile_quantities
from identknee.identify.profile.result import Profile
from identknee.identify.profile.thresholds import (
    bootstrap_statistics,
    chi2_threshold,
    f_threshold,
    resimulated,
)
from identknee.laxity.named_trials import TrialsLike, read_trials
from identknee.laxity.protocol import Protocol
from identknee.model.quantities import quantity_named
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry
from identknee.runs.files import PathLike
from identknee.runs.workers import Workers
from identknee.subject.uncertainty import UncertainLike
from identknee.verbs.answer import Answer
from identknee.verbs.identification import Identification, best_fits, identification
from identknee.verbs.values import BoundsLike, NoiseLike
from identknee.verbs.verb import LaxityLike, Run, SubjectLike, verb

Pair = str | tuple[str, str]


@declared
class Profiles(Answer):
    """Profile likelihoods: what the data say of each parameter, and of predictions."""

    parameters: Mapping[str, Profile] = entry(
        "Profile of each parameter by its name", rows="quantity", group="profile"
    )
    quantities: Mapping[str, Profile] = entry(
        "Profile of each prediction by its name", rows="quantity", group="profile_quantities"
    )
    pairs: tuple[PairProfile, ...] = entry(
        "Joint sets of two parameters", rows="pair", group="profile_pairs"
    )
    parameter_names: tuple[str, ...] = array(
        "Names of the parameters fitted", "parameter", is_in_arrays=False
    )
    optimum: Array = array(
        "Theta of the best fit known", "parameter", unit=OF_PARAMETER, key="theta"
    )
    deviance: float = entry("Deviance of the best fit known", unit="1")
    degrees_of_freedom: int | None = entry(
        "Degrees of freedom of the noise estimated from the fit; null where the noise is stated"
    )

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """All profiles, those of parameters first."""
        return (*self.parameters.values(), *self.quantities.values())

    @property
    @derived("Best fit by parameter", unit=OF_PARAMETER, key="optimum")
    def optimum_by_name(self) -> dict[str, float]:
        """Theta of the best fit by parameter."""
        return dict(zip(self.parameter_names, self.optimum.tolist(), strict=True))

    @property
    @derived("Simulations made for the profiles, each with its Jacobian", unit="1")
    def n_simulations(self) -> int:
        """Simulations made, each with its Jacobian."""
        pairs = sum(x.n_simulations for x in self.pairs)
        return pairs + sum(x.n_simulations for x in self.profiles)


@verb
def profile(
    run: Run,
    subject: SubjectLike,
    data: LaxityLike,
    *,
    parameters: Sequence[str] | None = None,
    quantities: Sequence[str] | None = None,
    forces: Sequence[str] | None = None,
    trials: TrialsLike | None = None,
    pairs: Sequence[Pair] | None = None,
    level: float = 0.95,
    budget: int = 1000,
    bootstrap: int = 0,
    noise: NoiseLike = None,
    uncertain: UncertainLike = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    bounds: BoundsLike = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> Profiles:
    """Which values of each parameter, or of any prediction, the data allow.

    Parameters
    ----------
    subject
        A knee, its folder, or the name of one that comes with identknee.
    data
        Measured laxity, its CSV file, or the name of a subject that comes with one.
    parameters
        Names such as ``ACL.stiffness_kN``; all but nuisances if None.
    quantities
        Predictions too: ``ACL.tension_N@TRIAL`` or ``varus_deg@TRIAL``.
    forces
        Trials in which the forces of all ligaments are profiled.
    trials
        Trials of `quantities` and `forces`, if not those of the data: a protocol, the name of one,
        its TOML file, or a laxity table.
    pairs
        Pairs of parameters whose joint set is wanted.
    level
        Confidence level of the sets.
    budget
        Simulations that a profile may make.
    bootstrap
        Simulated data sets that the thresholds come from; the chi-squared or F law if 0.
    uncertain
        How well geometry, frames and loads are known, as in
        ``"insertions=2mm,registration=2deg"``, in place of what the subject states; ``"none"`` for
        exactly.
    noise, start, fixed, bounds
        As for `identknee.verbs.identification.identification`.
    out
        Folder for the results, and for the work of a run that was stopped, which the same call
        resumes; nothing is written if None.
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
    asked = None if trials is None else read_trials(trials)
    setup = identification(
        run.knee, run.laxity, noise=noise, start=start, fixed=fixed, bounds=bounds
    )
    if bootstrap and setup.degrees_of_freedom is not None:
        raise ValueError(
            "--bootstrap simulates noise of a stated size; state it with --noise, for example "
            "--noise 0.5mm,0.5deg"
        )
    # Refuses a level that is none before anything takes time.
    threshold = _threshold(setup, level)
    wanted = [
        *_parameters(setup, parameters),
        *_predictions(setup, quantities or (), forces or (), asked),
    ]
    couples = [_couple(setup, x) for x in pairs or ()]
    run.start_clock()
    fits = best_fits(setup, seed=seed, executor=run.executor)
    thresholds = (
        _bootstrapped(run, setup, fits[0].theta, wanted, (level, bootstrap, seed))
        if bootstrap
        else threshold
    )
    profiles = profile_quantities(
        setup.problem,
        fits[0].theta,
        wanted,
        executor=run.executor,
        store=run.store,
        level=level,
        budget=budget,
        thresholds=thresholds,
    )
    best = min(profiles, key=lambda x: x.deviance)
    names = setup.problem.parameters.names
    return Profiles(
        parameters={x.name: x for x in profiles if x.name in names},
        quantities={x.name: x for x in profiles if x.name not in names},
        pairs=_joint_sets(run, setup, best.optimum, couples, level),
        parameter_names=names,
        optimum=best.optimum,
        deviance=best.deviance,
        degrees_of_freedom=setup.degrees_of_freedom,
        assumptions=setup.assumptions,
        **setup.uncertain_at(best.optimum),
        findings=setup.findings_at(best.optimum, best.deviance, fits),
    )


def _parameters(setup: Identification, chosen: Sequence[str] | None) -> list[Quantity]:
    parameters = setup.problem.parameters
    names = chosen or parameters.names_of_interest
    for name in names:
        setup.free_index(name, "--parameter")
    return [ParameterQuantity(parameters=parameters, name=name) for name in names]


def _predictions(
    setup: Identification, names: Sequence[str], forces: Sequence[str], trials: Protocol | None
) -> list[Quantity]:
    model = setup.model
    if trials is not None:
        model = model.with_protocol(trials)
    ligaments = [x.name for x in setup.knee.ligaments]
    texts = [*names, *(f"{x}.tension_N@{trial}" for trial in forces for x in ligaments)]
    return [
        RestrictedQuantity(quantity=quantity_named(model, text), free=setup.free) for text in texts
    ]


def _couple(setup: Identification, pair: Pair) -> tuple[str, str]:
    text = pair if isinstance(pair, str) else ",".join(pair)
    first, comma, second = (x.strip() for x in text.partition(","))
    if not comma:
        raise ValueError(
            f"--pair {text}: there is no second name. "
            "Write for example --pair ACL.stiffness_kN,ACL.reference_strain_pct"
        )
    for name in (first, second):
        setup.free_index(name, "--pair")
    if first == second:
        raise ValueError(f"--pair {text}: a pair needs two different parameters")
    return first, second


def _joint_sets(
    run: Run, setup: Identification, theta: Array, couples: Sequence[tuple[str, str]], level: float
) -> tuple[PairProfile, ...]:
    return tuple(
        profile_pair(
            setup.problem,
            theta,
            couple,
            level=level,
            threshold=_threshold(setup, level, 2),
            executor=run.executor,
            store=run.store,
        )
        for couple in couples
    )


def _threshold(setup: Identification, level: float, n: int = 1) -> float:
    """Rise of the deviance that bounds the set of `n` quantities."""
    if setup.degrees_of_freedom is not None:
        return float(f_threshold(level, setup.degrees_of_freedom, n))
    return float(chi2_threshold(level, n))


def _bootstrapped(
    run: Run,
    setup: Identification,
    theta: Array,
    wanted: Sequence[Quantity],
    settings: tuple[float, int, int],
) -> Array:
    """Threshold of each quantity from simulated data, shape ``(n,)``."""
    level, n, seed = settings
    statistics = bootstrap_statistics(
        partial(resimulated, setup.problem, theta),
        theta,
        wanted,
        n=n,
        seed=seed,
        executor=run.executor,
        store=run.store,
    )
    thresholds = statistics.thresholds(level)[:, 0]
    # A quantity that no data set moves, as the force of a slack ligament, has no statistic.
    return np.where(thresholds > 0, thresholds, _threshold(setup, level))
