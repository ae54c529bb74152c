"""Other parameter sets that the data could not tell apart, and what follows wrongly from them."""

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import restricted, with_bounds
from identknee.calibrate.quantity import Quantity, RestrictedQuantity
from identknee.identify.equivalents import EquivalentSets
from identknee.identify.equivalents import equivalents as equivalent_sets
from identknee.identify.region import Region, noise_region, power_of_best_test
from identknee.laxity.named_trials import TrialsLike, read_trials
from identknee.laxity.protocol import Protocol
from identknee.model.equivalence import largest_loads, rms_blocks
from identknee.model.quantities import ligament_forces, tensions_of
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_COORDINATE, OF_PARAMETER, array, declared, entry
from identknee.runs.files import PathLike
from identknee.runs.outcome import Outcome
from identknee.runs.progress import planned
from identknee.runs.workers import Workers
from identknee.subject.uncertainty import UncertainLike
from identknee.verbs.answer import Answer
from identknee.verbs.averaged import averaged
from identknee.verbs.identification import (
    Identification,
    check_start,
    identification,
    no_prediction,
)
from identknee.verbs.values import BoundsLike, NoiseLike, bounds_of, check_word
from identknee.verbs.verb import LaxityLike, Run, SubjectLike, verb

Criterion = Literal["noise", "paper"]
Forces = Literal["largest", "all", "none"]
GROUP = "equivalent_sets"
SHORTER = (
    "For a shorter run: --forces none finds the ranges of parameters alone, --n-sets fewer sets."
)


@declared
class Equivalents(Answer):
    """Parameter sets that the data cannot tell apart, and the ranges that they leave open."""

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
        "Sets, and ranges of parameters and forces over all equivalent sets",
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
    subject: SubjectLike,
    data: LaxityLike,
    *,
    n_sets: int = 100,
    criterion: Criterion = "noise",
    limit: float = 1.0,
    forces: Forces = "largest",
    trials: TrialsLike | None = None,
    noise: NoiseLike = None,
    uncertain: UncertainLike = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    bounds: BoundsLike = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> Equivalents:
    """Other parameter sets that the data could not tell apart, as different as can be.

    Parameters
    ----------
    subject
        A knee, its folder, or the name of one that comes with identknee.
    data
        Measured laxity, its CSV file, or the name of a subject that comes with one.
    n_sets
        Parameter sets wanted, at least 2.
    criterion
        ``"noise"``: predictions differ by no more than `limit` squared standard deviations in
        all. ``"paper"``: by 1 mm drawer, 1.2 deg varus and internal rotation (RMSE) at each angle.
    limit
        The largest squared difference, in units of the criterion.
    forces
        Ligament forces to bound: under the ``"largest"`` load of each kind at each angle, in
        ``"all"`` trials, or ``"none"``.
    trials
        Trials in which forces are bounded, if not those of the data: a protocol, the name of one,
        its TOML file, or a laxity table.
    uncertain
        How well geometry, frames and loads are known, as in
        ``"insertions=2mm,registration=2deg"``, in place of what the subject states; ``"none"`` for
        exactly. These errors are averaged over to first order at the best fit.
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
    check_word("--criterion", criterion, get_args(Criterion))
    check_word("--forces", forces, get_args(Forces))
    asked = None if trials is None else read_trials(trials)
    setup = identification(
        run.knee, run.laxity, noise=noise, start=start, fixed=fixed, bounds=bounds
    )
    setup, _ = averaged(setup, seed=seed, executor=run.executor)
    check_start(setup)
    quantities = _forces(setup, forces, asked)
    run.start_clock()
    best = fit(setup.problem, setup.start)
    if best.outcome is Outcome.START_FAILED:
        raise no_prediction(setup)
    region = _region(setup, criterion, best.theta, limit, bounds=bounds)
    n, q = setup.problem.parameters.n, len(quantities)
    told = f"finding the ranges of {n} parameters and {q} ligament forces"
    with planned(told, _work(n, q, n_sets), shorter=SHORTER):
        sets = equivalent_sets(
            region,
            quantities=quantities,
            n_sets=n_sets,
            seed=seed,
            executor=run.executor,
            store=run.store,
        )
    model = setup.model
    predictions = [model.predict(x, derivatives=False) for x in setup.free.expand(sets.sets)]
    fitted = setup.free.expand(sets.fit).tolist()
    return Equivalents(
        criterion=criterion,
        power_of_best_test=power_of_best_test(limit) if criterion == "noise" else None,
        fit=dict(zip(model.parameters.names, fitted, strict=True)),
        region=sets,
        trials=model.protocol.trials,
        ligaments=tuple(x.name for x in model.knee.ligaments),
        coordinates=np.array([x.coordinates for x in predictions]),
        tension_N=np.array([tensions_of(model, x) for x in predictions]),
        assumptions=setup.assumptions,
        **setup.uncertain_at(best.theta),
        findings=setup.findings_at(best.theta, 2.0 * best.objective),
    )


def _work(n: int, n_quantities: int, n_sets: int) -> dict[str, list[float]]:
    """What each piece of work of both rounds costs, beside the others."""
    return {
        "simulating sets": [0.017] * (3 * n_sets),
        # Extrema of parameters, of which there is a first guess, and of forces.
        "finding extrema": [0.03] * (4 * n) + [0.112] * (2 * n_quantities),
        "finding the diameter": [0.05] * 12,
        "looking along rays": [0.32] * 20,
    }


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


def _forces(setup: Identification, forces: Forces, asked: Protocol | None) -> list[Quantity]:
    if forces == "none":
        return []
    protocol = asked
    if protocol is None:
        # A blank trial may have no equilibrium, and then no forces.
        protocol = setup.laxity.protocol.select(setup.laxity.is_measured.any(axis=1))
    if forces == "largest":
        protocol = protocol.select(largest_loads(protocol))
    return [
        RestrictedQuantity(quantity=force, free=setup.free)
        for force in ligament_forces(setup.model, protocol)
    ]
