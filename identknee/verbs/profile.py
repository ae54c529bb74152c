"""Which values of each parameter, or of any prediction, the data allow."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Unpack

import numpy as np
from typing_extensions import override

from identknee.calibrate.fit import Fit
from identknee.calibrate.problem import (
    ParameterQuantity,
    Quantity,
    RestrictedQuantity,
    with_all_priors,
)
from identknee.identify.optimum import best_fits as lowest_fits
from identknee.identify.profile.pairs import PairProfile, profile_pair
from identknee.identify.profile.profile import other_optima, profile_quantities
from identknee.identify.profile.result import (
    Profile,
    ProfileVerdict,
    bootstrap_statistics,
    chi2_threshold,
    f_threshold,
    resimulated,
)
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import TrialsLike, read_trials
from identknee.model.quantities import force_names, quantity_named
from identknee.runs.declare import OF_PARAMETER, Array, array, declared, derived, entry
from identknee.runs.findings import Doubt, Finding
from identknee.verbs import options
from identknee.verbs.answer import Answer, has_priors
from identknee.verbs.identification import Identification, best_fits, identification
from identknee.verbs.options import option, trials_option
from identknee.verbs.verb import Run, verb

Pair = str | tuple[str, str]
# Other ends of searches that a fit with priors begins from too.
N_OTHERS = 4


@declared
class Profiles(Answer):
    """Profile likelihoods: what the data say of each parameter, and of predictions."""

    parameters: Mapping[str, Profile] = entry(
        "Profile of each parameter by its name", rows="quantity", group="profile"
    )
    quantities: Mapping[str, Profile] = entry(
        "Profile of each prediction by its name", rows="quantity", group="profile_quantities"
    )
    with_priors: Mapping[str, Profile] = entry(
        "Profile with the priors of ligament parameters, of each parameter that the data alone do "
        "not bound on both sides; none where `--priors` says what to do",
        rows="quantity",
        group="profile_with_priors",
        default_factory=dict,
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
        return dict(zip(self.parameter_names, self.optimum.tolist(), strict=True))

    @property
    @derived(
        "Whether the model leaves more misfit than the noise (p < 0.05): nothing is then known"
    )
    def conditional_on_misfit(self) -> bool:
        """Whether data and priors of nuisances reject the best fit."""
        return any(x.conditional_on_misfit for x in self.profiles)

    @property
    @override
    def parameter_set(self) -> dict[str, float]:
        """Theta of the best fit by parameter."""
        return self.optimum_by_name

    @property
    @derived("Simulations made for the profiles, each with its Jacobian", unit="1")
    def n_simulations(self) -> int:
        pairs = sum(x.n_simulations for x in self.pairs)
        profiles = (*self.profiles, *self.with_priors.values())
        return pairs + sum(x.n_simulations for x in profiles)


@verb
def profile(
    run: Run,
    subject: options.Subject,
    data: options.Data,
    *,
    parameters: Annotated[
        Sequence[str] | None,
        option(
            "Profile only this parameter, such as ACL.stiffness_kN.",
            "--parameter",
            in_python="A list of names; all but nuisance parameters if None.",
            metavar="NAME",
        ),
    ] = None,
    quantities: Annotated[
        Sequence[str] | None,
        option(
            f"Also profile a prediction. {options.PREDICTIONS} TRIAL is a name from the column "
            "trial of the data.",
            "--quantity",
            in_python="A list of names.",
            metavar="NAME",
        ),
    ] = None,
    forces: Annotated[
        Sequence[str] | None,
        option(
            "Also profile the forces of all ligaments in this trial, those of a group as one.",
            in_python="A list of names.",
            metavar="TRIAL",
        ),
    ] = None,
    trials: Annotated[
        TrialsLike | None,
        trials_option(
            "Where the trials of {--quantity} and {--forces} stand, if not in the data: {}."
        ),
    ] = None,
    pairs: Annotated[
        Sequence[Pair] | None,
        option(
            "Also outline the joint confidence region of two parameters.",
            "--pair",
            in_python="A list of pairs.",
            metavar="NAME,NAME",
            typed=list[str] | None,
        ),
    ] = None,
    level: options.Level = 0.95,
    budget: Annotated[
        int,
        option("Largest number of simulations per profile. Most profiles need 25 to 100.", least=1),
    ] = 1000,
    bootstrap: Annotated[
        int,
        option(
            "Take thresholds from N simulated data sets (at least 20 for a level of 0.95) instead "
            "of the chi-squared law.",
            metavar="N",
            least=0,
        ),
    ] = 0,
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    bounds: options.Bounds = None,
    priors: options.Priors = None,
    discrepancy: options.Discrepancy = "none",
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> Profiles:
    """Which values of each parameter, or of any prediction, the data allow.

    Each parameter gets a verdict and an interval: the values that the data do not exclude. The
    interval ends only where the data end it; an open end is null in result.json.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputable
        If no parameters near the start have a prediction in every measured trial.
    """
    asked = None if trials is None else read_trials(trials)
    setup = identification(
        subject,
        data,
        noise=noise,
        start=start,
        fixed=fixed,
        bounds=bounds,
        priors=has_priors("profile", priors),
        discrepancy=discrepancy,
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
    couples = [_pair_of_parameters(setup, x) for x in pairs or ()]
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
        starts=other_optima(
            setup.problem,
            fits[0].theta,
            threshold=float(np.max(thresholds)),
            known=fits[1:],
            executor=run.executor,
        ),
    )
    best = min(profiles, key=lambda x: x.deviance)
    findings = setup.findings_at(best.optimum, best.deviance, fits)
    profiles = tuple(_with_doubts(x, findings) for x in profiles)
    names = setup.problem.parameters.names
    left_open = [
        x.name for x in profiles if x.name in names and x.verdict is not ProfileVerdict.IDENTIFIABLE
    ]
    return Profiles(
        parameters={x.name: x for x in profiles if x.name in names},
        quantities={x.name: x for x in profiles if x.name not in names},
        with_priors={}
        if priors is not None
        else {
            name: _with_doubts(x, findings)
            for name, x in _with_priors(
                run, setup, fits, left_open, seed=seed, level=level, budget=budget
            ).items()
        },
        pairs=tuple(
            profile_pair(
                setup.problem,
                best.optimum,
                couple,
                level=level,
                threshold=_threshold(setup, level, 2),
                executor=run.executor,
                store=run.store,
            )
            for couple in couples
        ),
        parameter_names=names,
        optimum=best.optimum,
        deviance=best.deviance,
        degrees_of_freedom=setup.degrees_of_freedom,
        assumptions=setup.assumptions,
        **setup.uncertain_at(best.optimum),
        findings=findings,
    )


def _with_doubts(profile: Profile, findings: Sequence[Finding]) -> Profile:
    """The profile with why nothing is known at its fit; priors of ligaments fit no better."""
    doubts = {x.kind.doubt for x in findings}
    return replace(
        profile,
        conditional_on_misfit=Doubt.MISFIT in doubts,
        at_implausible_fit=Doubt.IMPLAUSIBLE in doubts,
    )


def _with_priors(
    run: Run,
    setup: Identification,
    fits: Sequence[Fit],
    names: Sequence[str],
    *,
    seed: int,
    level: float,
    budget: int,
) -> dict[str, Profile]:
    """Profiles of parameters with the priors of ligament parameters."""
    if not names:
        return {}
    parameters = setup.problem.parameters
    found = lowest_fits(
        with_all_priors(setup.everywhere),
        start=np.clip(fits[0].theta, parameters.lower, parameters.upper),
        seed=seed,
        executor=run.executor,
        points=np.array([setup.start, *(x.theta for x in fits[1:N_OTHERS])]),
    )
    problem, threshold = with_all_priors(setup.problem), _threshold(setup, level)
    profiles = profile_quantities(
        problem,
        found[0].theta,
        _parameters(setup, names),
        executor=run.executor,
        level=level,
        budget=budget,
        thresholds=threshold,
        starts=other_optima(
            problem,
            found[0].theta,
            threshold=threshold,
            known=found[1:],
            executor=run.executor,
        ),
    )
    return {x.name: x for x in profiles}


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
    return [
        RestrictedQuantity(quantity=quantity_named(model, name), free=setup.free)
        for name in (*names, *force_names(model, forces))
    ]


def _pair_of_parameters(setup: Identification, pair: Pair) -> tuple[str, str]:
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
