"""The numbers in the sentences of the page, from the records."""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from beyond_tables import AT_TRUTH, CRITERION, SHELLS, is_truth
from common import published
from page_tables import (
    BASINS,
    CHECKS,
    EQUIVALENTS,
    EVALUATION,
    GUESSES,
    PAPER,
    Found,
    knees,
    part_of,
    parts,
    profile_of,
    responses,
)

import identknee as ik
from identknee.verbs.demo import parameter_error

VERDICT = Path(__file__).parents[2] / "tests" / "verification" / "verdict.json"
NOT_YET = "(not computed yet)"
Row = Mapping[str, Any]


def numbers(found: Found) -> Callable[[str], str]:
    """What gives the text of a number by its name on the page.

    It raises ValueError for a name that nothing computes.
    """
    made: dict[str, str] = {}
    lacking = set()
    for prefix, (draw, needed) in PREFIXES.items():
        if all(found[study] is not None for study in needed):
            made.update(draw(found))
        else:
            lacking.add(prefix)

    def text_of(name: str) -> str:
        if name not in made and name.partition("_")[0] not in lacking:
            raise ValueError(f"the page asks for the number {name!r}, which nothing computes")
        return made.get(name, NOT_YET)

    return text_of


def of_laxity(found: Found) -> dict[str, str]:
    """How far the models are from the measured means."""
    mean, sd, printed = (
        np.array([getattr(x, key) for x in published.TABLE2])
        for key in ("mean", "sd", "paper_model")
    )
    sizes = {"paper": (printed - mean) / sd}
    sizes |= {name: (responses(found, name) - mean) / sd for name in knees(found)}
    made = {"laxity_rows": str(len(published.TABLE2))}
    for name, values in sizes.items():
        made[f"laxity_within_{name}"] = str(int((np.abs(values) <= 1).sum()))
        made[f"laxity_beyond2_{name}"] = str(int((np.abs(values) > 2).sum()))
    made["laxity_stiffest_stable"] = f"{-np.nanmin(sizes['lenhart2015_stable']):.1f}"
    outward = [
        values[[x.load.split()[0] == "external" for x in published.TABLE2]] for values in own(found)
    ]
    made["laxity_external"] = low_high(np.concatenate(outward), 0)
    valgus = [
        values[[x.load.split()[0] == "valgus" for x in published.TABLE2]] for values in own(found)
    ]
    made["laxity_valgus"] = low_high(np.concatenate(valgus), 1)
    unloaded = []
    for part in parts(found).values():
        rows = [i for i, x in enumerate(part["profile"]["trials"]) if x.endswith("unloaded")]
        coordinates = np.array(part["profile"]["at_truth"])[rows]
        unloaded.append(np.abs(coordinates[:, [ik.laxity.COORDINATES.index(x) for x in ROTATIONS]]))
    largest = np.max(unloaded, axis=(0, 1))
    made["laxity_zero_varus"], made["laxity_zero_internal"] = (f"{x:.1f}" for x in largest)
    return made


def of_guesses(found: Found) -> dict[str, str]:
    """The searches from the four guesses."""
    profile, made = profile_of(found), {}
    for start in PAPER.PAPER_TABLE3:
        before = parameter_error(profile["starts"][start], profile["truth"])
        made[f"guess_start_{start}"] = f"{before.mean_kN:.2f}"
        for name, part in parts(found).items():
            runs = PAPER.rows(part, start)
            for key in ("error_kN", "error_pct"):
                middle = np.median([np.mean(x[key]) for x in runs])
                made[f"guess_{key}_{start}_{name}"] = f"{middle:.2f}"
    runs = [x for part in parts(found).values() for x in part["complex"]]
    direct = [x for part in parts(found).values() for x in part["least-squares"]]
    made["guess_per_start"] = str(len(PAPER.rows(next(iter(parts(found).values())), "IG4")))
    made["guess_runs"] = str(len(runs))
    made["guess_polished"] = str(sum(at_truth(x["polished"]) for x in runs))
    made["guess_direct"] = str(sum(at_truth(x) for x in direct))
    made["guess_n_direct"] = str(len(direct))
    made["guess_most"] = str(max(x["n_simulations"] for x in direct))
    made["guess_simulations"] = f"{np.median([x['n_simulations'] for x in runs]):,.0f}"
    errors = np.array([x["rmse_by_flexion"] for x in runs])
    for key, name in (("drawer", "anterior_drawer_mm"), ("internal", "internal_deg")):
        made[f"guess_worst_{key}"] = f"{errors[..., ik.laxity.COORDINATES.index(name)].max():.2f}"
    for start in ("IG1", "IG4"):
        forces = [x["tension_by_scenario_N"] for x in runs if x["start"] == start]
        made[f"guess_force_{start}"] = f"{np.max(forces):.0f}"
    far = [
        np.median([x["error_kN"] for x in PAPER.rows(part, "IG4")], axis=0)
        for part in parts(found).values()
    ]
    worst = int(np.argmax(np.min(far, axis=0)))
    made["guess_worst_ligament"] = profile["ligaments"][worst]
    made["guess_worst_kN"] = low_high([x[worst] for x in far], 1)
    return made


def of_checks(found: Found) -> dict[str, str]:
    """What study 13 checked itself."""
    checks = [part_of(found, CHECKS, name) for name in knees(found)]
    small = [x["small_errors"] for x in checks]
    unfitted = [x["before_any_fit"]["IG4"] for x in checks]
    fitted = [x["one_way"]["fitted"] for x in checks]
    means = [[np.mean(x[key]) for x in fitted] for key in ("error_kN", "error_pct")]
    columns = [
        abs(one - other)
        for table in (PAPER.PAPER_TABLE6, PAPER.PAPER_TABLE7)
        for row in table.values()
        for one, other in row
    ]
    printed = [one for row in PAPER.PAPER_TABLE6.values() for one, _ in row]
    seeds = {len(x["course"]["IG4"]) for x in checks}
    return {
        "check_draws": str(small[0]["n"]),
        "check_small_force": f"{np.max([x['tension_by_scenario_N'] for x in small]):.0f}",
        "check_paper_force": str(max(printed)),
        "check_unfitted_force": f"{np.max([x['tension_by_scenario_N'] for x in unfitted]):.0f}",
        "check_factor": f"{max(printed) / np.max([x['tension_by_scenario_N'] for x in small]):.0f}",
        "check_unfitted_ACL": f"{max(largest_of(found, 'ACL')):.0f}",
        "check_columns_apart": low_high(columns, 0),
        "check_seeds": ", ".join(str(x) for x in sorted(seeds)),
        "check_soft_kN": low_high(means[0], 1),
        "check_soft_pct": low_high(means[1], 1),
        "check_soft_mm": low_high([x["rmse_mm"] for x in fitted], 2),
        "check_soft_deg": low_high([x["rmse_deg"] for x in fitted], 2),
        "check_soft_ACL": low_high([x["error_kN"][0] for x in fitted], 1),
        "check_step_varus": f"{min(x['smallest_step']['varus_deg'] for x in checks):.1f}",
    }


def of_basins(found: Found) -> dict[str, str]:
    """Ends and radii of study 03."""
    record = found[BASINS]
    assert record is not None
    rows = [row for _, _, row in ends_of(record, "_complex")]
    ends = sum(row["n_starts"] - row["kinds"].get("start_failed", 0) for row in rows)
    made = {
        "basin_ends": f"{ends:,}",
        "basin_minima": str(sum(row["kinds"].get("minimum", 0) for row in rows)),
        "basin_cliffs": str(sum(row["kinds"].get("cliff", 0) for row in rows)),
        "basin_polished": f"{sum(row['polished_outcomes'].get('minimum', 0) for row in rows):,}",
        "basin_at_truth": f"{sum(sum(truths(*x)) for x in ends_of(record, '_complex')):,}",
        "basin_reach": f"{record['head']['settings']['distances'][-1]:g}",
        **everywhere(record),
    }
    for knee, part in record["knees"].items():
        for method, name in SHELLS.items():
            if name in part["parts"]:
                row = part["parts"][name]
                radii = row["recovered"][CRITERION]["radii"]
                label = f"{method.replace(' ', '_')}_{knee}"
                for share, radius in radii.items():
                    text = "any distance tried" if radius[0] is None else f"{radius[0]:.2f}"
                    made[f"basin_{share}_{label}"] = text
                failed = row["kinds"].get("start_failed", 0)
                made[f"basin_failed_{label}"] = f"{100 * failed / row['n_starts']:.0f}"
                made[f"basin_starts_{label}"] = f"{row['n_starts']:,}"
    return made


def ends_of(record: Row, ending: str) -> list[tuple[str, Row, Row]]:
    """Knee, its part of the record, and each of its sweeps with a name that ends so."""
    return [
        (knee, part, row)
        for knee, part in record["knees"].items()
        for name, row in part["parts"].items()
        if name.endswith(ending)
    ]


def truths(_: str, part: Row, row: Row) -> list[int]:
    """How many starts lead to the truth, by basin: none for a basin elsewhere."""
    return [x["n_starts"] * is_truth(part, x) for x in row["basins"]]


def everywhere(record: Row) -> dict[str, str]:
    """Where least squares from all over the bounds ended."""
    sweeps = ends_of(record, "bounds_least_squares")
    reached = [sum(truths(*x)) for x in sweeps]
    minima = [row["polished_outcomes"].get("minimum", 0) for _, _, row in sweeps]
    others = [n - at for n, at in zip(minima, reached, strict=True)]
    knees_of = [knee for (knee, _, _), n in zip(sweeps, others, strict=True) if n]
    return {
        "basin_direct": f"{sum(reached):,}",
        "basin_other": f"{sum(others):,}",
        "basin_other_knees": ", ".join(knees_of) or "no knee",
    }


def of_folds(found: Found) -> dict[str, str]:
    """The knee with raw insertions."""
    part = part_of(found, EVALUATION, "lenhart2015")
    lost = part["seed63"]["not_converged"]
    loads = [abs(x["last_stable_load"]) for x in part["ramps"] if x["outcome"] == "fold"]
    turned = [
        abs(x["single_step_coordinates"][ik.laxity.COORDINATES.index("internal_deg")]) for x in lost
    ]
    return {
        "fold_converged": str(sum(x["single_step_outcome"] == "converged" for x in lost)),
        "fold_lost": str(len(lost)),
        "fold_trials": str(part["seed63"]["n_trials"]),
        "fold_loads": low_high(loads, 1),
        "fold_turned": low_high(turned, 0),
    }


def of_equivalents(found: Found) -> dict[str, str]:
    """How far apart sets are that the paper's criterion lets pass."""
    record = found[EQUIVALENTS]
    assert record is not None
    cases = [x["cases"]["paper"] for x in record["knees"].values() if "paper" in x["cases"]]
    forces = [x["forces"]["by_scenario_N"] for x in cases]
    known = np.array(forces, dtype=np.float64)
    return {"equivalent_force": f"{np.nanmax(known):.0f}" if cases else NOT_YET}


def of_meshes(_: Found) -> dict[str, str]:
    """The paper's contact law beside the integral, from the record of the verification."""
    verdict = json.loads(VERDICT.read_text(encoding="utf-8"))
    made = {}
    for key, what in MESH_LAWS.items():
        (row,) = [
            x
            for x in verdict["rows"]["mesh_law"]["measures"]
            if x["what"] == what and x["unit"] == "deg"
        ]
        made[f"mesh_{key}_median"], made[f"mesh_{key}"] = f"{row['low']:.2f}", f"{row['high']:.1f}"
    return made


def own(found: Found) -> Iterable[np.ndarray]:
    """Responses of all knees."""
    return (responses(found, name) for name in knees(found))


def largest_of(found: Found, ligament: str) -> list[float]:
    """Largest change of a ligament's tension at IG4 itself, by knee."""
    index = profile_of(found)["ligaments"].index(ligament)
    return [
        max(
            row[index]
            for row in part_of(found, CHECKS, name)["before_any_fit"]["IG4"][
                "tension_by_scenario_N"
            ]
        )
        for name in knees(found)
    ]


def at_truth(end: Row) -> bool:
    """Whether a fit ended at the true parameters."""
    return bool(max(*end["error_kN"], *end["error_pct"]) < AT_TRUTH)


def low_high(values: Iterable[float], decimals: int) -> str:
    """Smallest to largest; one number where they read alike."""
    low, high = (f"{f(list(values)):.{decimals}f}" for f in (min, max))
    return low if low == high else f"{low} to {high}"


# The verification's names of the two ways, with the finest meshes that it judges.
MESH_LAWS = {
    "both": "two-way sum, 0.8 mm edges",
    "tibia": "one-way, vertices of the tibia, 0.8 mm edges",
}
ROTATIONS = ("varus_deg", "internal_deg")
PREFIXES: Mapping[str, tuple[Callable[[Found], dict[str, str]], tuple[str, ...]]] = {
    "laxity": (of_laxity, (GUESSES, EVALUATION)),
    "guess": (of_guesses, (GUESSES,)),
    "check": (of_checks, (GUESSES, CHECKS)),
    "basin": (of_basins, (BASINS,)),
    "fold": (of_folds, (EVALUATION,)),
    "equivalent": (of_equivalents, (EQUIVALENTS,)),
    "mesh": (of_meshes, ()),
}
