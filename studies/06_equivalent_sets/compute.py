"""Slow part of the study: equivalent sets of two knees by noise and by the paper's criterion.

Writes ``records/equivalent_sets.json`` after each part. Finished searches are kept in stores
outside the checkout, so that the same command resumes where it was stopped.
"""

import argparse
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.largest import largest_by
from common.problems import model_of, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.identify.equivalents import EquivalentSets, equivalents

KNEES = ("reference", "lenhart2015_stable")
PAPER = "paper"
N_SETS, SEED = 100, 0
SCENARIOS = (
    "anterior force",
    "posterior force",
    "varus moment",
    "valgus moment",
    "external moment",
    "internal moment",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What counts as equivalent.

    Attributes
    ----------
    name
        What it is called in the record.
    sd
        Standard deviation of the noise [mm and deg]; None for the paper's criterion.
    limit
        The largest squared difference.
    """

    name: str
    sd: float | None
    limit: float = 1.0


CASES = (
    Case(name="0.5 mm, 0.5 deg", sd=0.5),
    Case(name=PAPER, sd=None),
    Case(name="0.3 mm, 0.3 deg", sd=0.3),
    Case(name="1.0 mm, 1.0 deg", sd=1.0),
    Case(name="0.5 mm, 0.5 deg, D2 <= 3.84", sd=0.5, limit=3.84),
)


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = records.parsed_options(__file__, "one case and few forces only", n_sets=N_SETS)
    knees = {name: study_knee(name) for name in KNEES}
    record = records.begun(options, KNEES, seed=SEED, paper_limits=ik.model.PAPER_LIMITS)
    inputs = record["head"]["inputs"]
    with ik.runs.process_pool(options.workers) as executor:
        for name, knee in knees.items():
            model = model_of(knee)
            part = record["knees"][name] = {"setting": setting(model), "cases": {}}
            for case in CASES[:1] if options.quick else CASES:
                about = {"knee": inputs[name], "case": case.name, "n_sets": options.n_sets}
                path = options.store / f"{name} {case.name}.sqlite".replace(" ", "_")
                began = time.perf_counter()
                found = searched(model, case, options, executor, (path, about))
                part["cases"][case.name] = {
                    **described(model, case, found, quick=options.quick),
                    "seconds": round(time.perf_counter() - began, 1),
                }
                write_record(options.record, record)
                records.say(f"{name}, {case.name}: {found.n_simulations} simulations")
    records.say(f"written: {options.record.name}")


def region_of(model: ik.LaxityModel, case: Case) -> ik.identify.Region:
    """What is equivalent to the truth in the 63 trials."""
    truth = truth_of(model.parameters)
    laxity = model.simulate(truth)
    if case.sd is None:
        plain = ik.LaxityResiduals(model=model, laxity=laxity)
        return ik.identify.Region(
            problem=plain, center=truth, blocks=ik.model.rms_blocks(plain), limit=case.limit
        )
    # Noise of this size is stated, and none added: the region is around the truth itself.
    sd = ik.add_noise(laxity, sd_mm=case.sd, sd_deg=case.sd, seed=0).sd
    stated = ik.LaxityResiduals(model=model, laxity=replace(laxity, sd=sd), weighting="noise")
    return ik.identify.noise_region(stated, truth, limit=case.limit)


def force_trials(model: ik.LaxityModel, *, quick: bool) -> ik.Protocol:
    """Where ligament forces are compared: the 63 trials and the drawer forces of Table 7."""
    protocol = ik.laxity.concatenate([model.protocol, ik.load_protocol("drawer")])
    if quick:
        return protocol.select([is_shown(name) for name in protocol.trials])
    return protocol


def searched(
    model: ik.LaxityModel,
    case: Case,
    options: argparse.Namespace,
    executor: ik.runs.Executor,
    work: tuple[Path, Row],
) -> EquivalentSets:
    """The sets and extrema of one case."""
    path, about = work
    with ik.runs.open_work(path, {**about, "quick": options.quick, "seed": SEED}) as store:
        return equivalents(
            region_of(model, case),
            quantities=ik.model.ligament_forces(model, force_trials(model, quick=options.quick)),
            n_sets=options.n_sets,
            seed=SEED,
            executor=executor,
            store=store,
        )


def setting(model: ik.LaxityModel) -> Row:
    """The truth, and the names that go with all arrays."""
    truth = truth_of(model.parameters)
    row: Row = rounded(
        {
            "parameters": model.parameters.names,
            "truth": truth,
            "bounds": [model.parameters.lower, model.parameters.upper],
            "ligaments": [x.name for x in model.knee.ligaments],
            "flexion_angles_deg": angles(model),
            "scenarios": SCENARIOS,
            "trials": model.protocol.trials,
        }
    )
    return row


def described(model: ik.LaxityModel, case: Case, found: EquivalentSets, *, quick: bool) -> Row:
    """One case as the record keeps it."""
    truth = found.fit
    predictions = np.array([model.simulate(x).coordinates for x in [truth, *found.sets]])
    differences = predictions[1:] - predictions[0]
    row: Row = rounded(
        {
            "sd": case.sd,
            "limit": case.limit,
            "power_of_best_test": None
            if case.sd is None
            else ik.identify.power_of_best_test(case.limit),
            "outcome": found.outcome.value,
            "n_sets": len(found.sets),
            "diameter": found.diameter,
            "farthest": found.farthest,
            "closest": found.closest,
            "largest_distance": found.distances.max() / found.limit,
            "pair_searches": found.pair_searches,
            "n_simulations": found.n_simulations,
            "parameters": {name: sides(x) for name, x in found.parameters.items()},
            "forces": force_tables(model, found, force_trials(model, quick=quick)),
            "chosen_forces": {
                name: sides(x) for name, x in found.quantities.items() if is_shown(name)
            },
            "ends": counted(found.quantities.values()),
            "sets": found.sets,
            "bands": {
                name: np.vstack(
                    [
                        differences[:2, :, j],
                        differences[:, :, j].min(0),
                        differences[:, :, j].max(0),
                    ]
                )
                for j, name in enumerate(ik.laxity.COORDINATES)
                if name in ik.model.PAPER_LIMITS
            },
            "rmse": errors_of(model, found),
        },
        5,
    )
    return row


def sides(of: ik.identify.Extrema) -> Row:
    """Both ends of a quantity's range."""
    return {
        "truth": of.at_fit,
        "range": [of.lower.value, of.upper.value],
        "ends": [x.end.value for x in (of.lower, of.upper)],
        "at_bounds": [list(x.at_bounds) for x in (of.lower, of.upper)],
        "agreeing": [f"{x.n_agreeing} of {x.n_searches}" for x in (of.lower, of.upper)],
    }


def is_shown(name: str) -> bool:
    """Whether the figure shows the forces of a trial: the largest internal and external moments."""
    return name.endswith(("internal10Nm", "internal-10Nm"))


def counted(extrema: Iterable[ik.identify.Extrema]) -> Row:
    """How many extrema of forces ended in which way, and were found by one search only."""
    both = [side for x in extrema for side in (x.lower, x.upper)]
    words = sorted({side.end.value for side in both})
    return {
        **{word: sum(side.end.value == word for side in both) for word in words},
        "found_once": sum(side.n_agreeing < 2 for side in both),
    }


def force_tables(model: ik.LaxityModel, found: EquivalentSets, protocol: ik.Protocol) -> Row:
    """Largest difference of every ligament's force from the truth, by flexion and by scenario."""
    n_ligaments = len(model.knee.ligaments)
    farthest = np.array(
        [max(x.upper.value - x.at_fit, x.at_fit - x.lower.value) for x in found.quantities.values()]
    ).reshape(-1, n_ligaments)
    return {
        "by_flexion_N": largest_by(farthest, protocol.flexion_deg.tolist(), angles(model)),
        "by_scenario_N": largest_by(farthest, ik.laxity.load_scenarios(protocol), SCENARIOS),
    }


def errors_of(model: ik.LaxityModel, found: EquivalentSets) -> Row:
    """Largest kinematic error of any set by flexion angle, in mm and deg, as the paper counts."""
    at_truth = model.simulate(found.fit)
    errors: ik.runs.Array = np.array(
        [ik.laxity_rmse(model.simulate(x), at_truth).by_flexion for x in found.sets]
    )
    return {
        name: errors[:, :, ik.laxity.COORDINATES.index(name)].max(axis=0)
        for name in ik.model.PAPER_LIMITS
    }


def angles(model: ik.LaxityModel) -> list[float]:
    """The flexion angles of the trials [deg], ascending."""
    return [float(x) for x in np.unique(model.protocol.flexion_deg)]


if __name__ == "__main__":
    main()
