"""Equivalent parameter sets, and the ranges of predictions over them."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Unpack

import numpy as np

from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import Quantity, RestrictedQuantity, restricted, with_bounds
from identknee.checks.usable_trials import residuals_of
from identknee.identify.equivalents import EquivalentSets
from identknee.identify.equivalents import equivalents as equivalent_sets
from identknee.identify.region import Region, noise_region, power_of_best_test
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import TrialsLike, read_trials
from identknee.model.line_loads import tensions_of
from identknee.model.quantities import force_names, quantity_named
from identknee.model.residuals import LaxityResiduals, largest_loads, rms_blocks
from identknee.runs.declare import OF_COORDINATE, OF_PARAMETER, Array, array, declared, entry
from identknee.runs.progress import planned
from identknee.runs.words import amount, parameter_words, unit_of
from identknee.verbs import options
from identknee.verbs.answer import Answer, has_priors
from identknee.verbs.identification import Identification, identification
from identknee.verbs.marginalise_nuisances import marginalise_nuisances
from identknee.verbs.options import option, trials_option
from identknee.verbs.values import BoundsLike, bounds_of
from identknee.verbs.verb import Run, verb

Criterion = Literal["noise", "paper"]
Forces = Literal["largest", "all", "none"]
GROUP = "equivalent_sets"
SHORTER = (
    "For a shorter run: --forces none finds the ranges of parameters alone, --n-sets fewer sets."
)


@declared
class Equivalents(Answer):
    """Equivalent parameter sets, and the ranges of quantities over them."""

    criterion: Criterion = entry(
        "What counts as equivalent: noise for a squared difference in units of the noise, paper "
        "for the limits of the paper"
    )
    power_of_best_test: float | None = entry(
        "Chance that the best 5 % test tells a set from the fit; null with the paper's criterion",
        unit="1",
    )
    fit: Mapping[str, float] = entry(
        "Fit by parameter, those held fixed included", unit=OF_PARAMETER
    )
    region: EquivalentSets = entry(
        "Sets, and ranges of parameters and predictions over all equivalent sets",
        group=GROUP,
        is_inline=True,
    )
    trials: tuple[str, ...] = array("Names of the trials", "trial", is_in_arrays=False)
    ligaments: tuple[str, ...] = array("Names of the ligaments", "ligament", is_in_arrays=False)
    coordinates: Array = array(
        "Laxity that each set predicts",
        *("set", "trial", "coordinate"),
        unit=OF_COORDINATE,
        group=GROUP,
    )
    tension_N: Array = array(  # noqa: N815 - the unit
        "Force of each ligament", "set", "trial", "ligament", unit="N", group=GROUP
    )


@verb
def equivalents(
    run: Run,
    subject: options.Subject,
    data: options.Data,
    *,
    n_sets: Annotated[int, option("Number of parameter sets to find.", least=2)] = 100,
    criterion: Annotated[
        Criterion,
        option(
            "When two sets count as equivalent. noise: the sum of squared differences is at most "
            "{--limit}, in standard deviations. paper: the RMSE at each angle is at most 1 mm of "
            "drawer and 1.2 deg of varus and internal rotation."
        ),
    ] = "noise",
    limit: Annotated[
        float,
        option(
            "The largest squared difference, in units of the criterion. With noise, 3.84 also "
            "allows sets that a 5 % test would tell apart more often."
        ),
    ] = 1.0,
    forces: Annotated[
        Forces,
        option(
            "Ligament forces to find the range of, those of a group as one: under the largest load "
            "of each kind at each angle, in all trials, or none."
        ),
    ] = "largest",
    quantities: Annotated[
        Sequence[str] | None,
        option(
            f"Also find the range of a prediction. {options.PREDICTIONS}",
            "--quantity",
            in_python="A list of names.",
            metavar="NAME",
        ),
    ] = None,
    trials: Annotated[
        TrialsLike | None,
        trials_option("Trials of forces and {--quantity}, if not of the data: {}."),
    ] = None,
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    bounds: options.Bounds = None,
    priors: options.Priors = None,
    discrepancy: options.Discrepancy = "none",
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> Equivalents:
    """Parameter sets that the data cannot distinguish, as different as possible.

    They predict the same laxity as the best fit, and are as different from each other as possible.
    The answer gives the smallest and largest value of every parameter, ligament force and other
    prediction among all such sets: what one could wrongly conclude. Every set is simulated. Stated
    errors of knee and tests are marginalised to first order at the best fit.

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
        priors=has_priors("equivalents", priors),
        discrepancy=discrepancy,
    )
    setup, fits = marginalise_nuisances(setup, seed=seed, executor=run.executor)
    predictions = _predictions(setup, quantities or (), forces, asked)
    run.start_clock()
    # Marginalised nuisances move the optimum.
    is_asked = fits[0].parameters.is_of_interest
    best = fit(setup.problem, fits[0].theta[is_asked])
    region = _region(setup, criterion, best.theta, limit, bounds=bounds)
    n, q = setup.problem.parameters.n, len(predictions)
    description = f"finding the ranges of {n} parameters and {q} predictions"
    with planned(
        description,
        {
            "simulating sets": [0.017] * (3 * n_sets),
            # Extrema of parameters, of which there is a first guess, and of predictions.
            "finding extrema": [0.03] * (4 * n) + [0.112] * (2 * q),
            "finding the diameter": [0.05] * 12,
            "looking along rays": [0.32] * 20,
        },
        shorter=SHORTER,
    ):
        sets = equivalent_sets(
            region,
            quantities=predictions,
            n_sets=n_sets,
            seed=seed,
            executor=run.executor,
            store=run.store,
        )
    model = setup.model
    simulated = [model.predict(x, derivatives=False) for x in setup.free.expand(sets.sets)]
    fitted = setup.free.expand(sets.fit).tolist()
    return Equivalents(
        criterion=criterion,
        power_of_best_test=power_of_best_test(limit) if criterion == "noise" else None,
        fit=dict(zip(model.parameters.names, fitted, strict=True)),
        region=sets,
        trials=model.protocol.trials,
        ligaments=tuple(x.name for x in model.knee.ligaments),
        coordinates=np.array([x.coordinates for x in simulated]),
        tension_N=np.array([tensions_of(model, x) for x in simulated]),
        assumptions=(*setup.assumptions, *_moved(setup, best)),
        **setup.uncertain_at(best.theta),
        findings=setup.findings_at(best.theta, 2.0 * best.objective),
    )


def _region(
    setup: Identification, criterion: Criterion, theta: Array, limit: float, *, bounds: BoundsLike
) -> Region:
    if criterion == "noise":
        return noise_region(setup.problem, theta, limit=limit)
    plain = LaxityResiduals(model=setup.model, laxity=setup.laxity)
    free = setup.free
    fixed = [x for x in free.everything.names if x not in free.parameters.names]
    return Region(
        problem=restricted(with_bounds(plain, bounds_of(bounds)), fixed, free.fixed_values),
        center=theta,
        blocks=rms_blocks(plain),
        limit=limit,
    )


def _moved(setup: Identification, best: Fit) -> tuple[str, ...]:
    """Which parameter marginalised nuisances move most from the fit, as a sentence; none without.

    The start of the search is the fit with nuisances among its parameters.
    """
    if setup.nuisances_at is None:
        return ()
    p = best.parameters
    apart = np.where(p.is_log, np.log(best.theta / best.start), best.theta - best.start)
    k = int(np.argmax(np.abs(apart / p.prior_sd)))
    name, unit = p.names[k], unit_of(p.names[k])
    here, before = amount(best.theta[k], unit), amount(best.start[k], unit)
    if here == before:
        return ()
    sentence = (
        "The column fit holds the best parameters with these errors marginalised, in which "
        f"{parameter_words(name)} is {here}; the best fit with the errors themselves has {before}."
    )
    return (sentence,)


def _predictions(
    setup: Identification, names: Sequence[str], forces: Forces, asked: Protocol | None
) -> list[Quantity]:
    # That of the residuals, whose simulation the predictions then share.
    model = residuals_of(setup.problem).model
    under = model if asked is None else model.with_protocol(asked)
    found = [quantity_named(under, x) for x in names]
    if forces != "none":
        protocol = asked
        if protocol is None:
            # A blank trial may have no equilibrium, and then no forces.
            protocol = setup.laxity.protocol.select(setup.laxity.is_measured.any(axis=1))
        if forces == "largest":
            protocol = protocol.select(largest_loads(protocol))
        own = {x.name for x in found}
        wanted = (x for x in force_names(under, protocol.trials) if x not in own)
        found += [quantity_named(under, x) for x in wanted]
    everything, varied = setup.free, setup.free.parameters.names
    values = dict(zip(everything.everything.names, everything.fixed_values, strict=True))
    parameters = model.parameters
    free = parameters.with_fixed(
        [x for x in parameters.names if x not in varied], [values[x] for x in parameters.names]
    )
    return [RestrictedQuantity(quantity=x, free=free) for x in found]
