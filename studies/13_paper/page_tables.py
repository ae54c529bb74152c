"""The tables of the page: the paper's numbers beside ours, from the records."""

from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

import numpy as np
from common import published
from common.page import table
from common.spreads import median_range, spread
from other_studies import module_of

import identknee as ik
from identknee.verbs.demo import parameter_error

EVALUATION, GUESSES, BASINS = "01_model_evaluation", "02_initial_guess", "03_basin_of_attraction"
PROFILES, EQUIVALENTS, OPTIMIZERS = "04_profiles", "06_equivalent_sets", "09_optimizers"
GAP, CHECKS = "11_reality_gap", "13_paper"
SOURCES = (EVALUATION, GUESSES, BASINS, PROFILES, EQUIVALENTS, OPTIMIZERS, GAP, CHECKS)
PAPER = module_of(GUESSES, "paper_tables")
# As the paper prints them: mean distances of the guesses from the reference [kN, %].
PAPER_DISTANCES = {"IG1": (0.0, 0.0), "IG2": (0.5, 0.5), "IG3": (1.1, 1.3), "IG4": (3.6, 3.5)}
QUANTITIES = {
    "anterior_drawer_mm": "drawer [mm]",
    "internal_deg": "internal [deg]",
    "varus_deg": "varus [deg]",
}
LOAD_UNITS = {"mm": "N", "deg": "N·m"}
# Opposite loads of Table 2 at one angle: the sum of their responses does not hang on the zero.
OPPOSITE = (("internal", "external"), ("varus", "valgus"), ("anterior", "posterior"))
Row = Mapping[str, Any]
Found = Mapping[str, Row | None]


def not_yet(study: str) -> str:
    """What stands where a table will be once a study has its record."""
    return (
        f"*Not computed yet: `python studies/{study}/compute.py`, then "
        "`python studies/13_paper/figures.py`.*"
    )


def tables(found: Found) -> dict[str, ik.report.Table | str]:
    """All tables of the page by the name of their place in it."""
    made: dict[str, ik.report.Table | str] = {}
    for name, (draw, needed) in TABLE_OF.items():
        lacking = [study for study in needed if found[study] is None]
        made[name] = not_yet(lacking[0]) if lacking else draw(found)
    return made


def table_1(found: Found) -> ik.report.Table:
    """Initial guesses, and their distances as printed and as recomputed."""
    profile = profile_of(found)
    body = []
    for start, printed in PAPER_DISTANCES.items():
        theta = np.array(profile["starts"][start])
        error = parameter_error(theta, profile["truth"])
        pairs = [f"{k:g}, {eps:g}" for k, eps in theta.reshape(2, -1).T]
        distances = ("{:.1f}, {:.1f}".format(*printed), f"{error.mean_kN:.3f}, {error.mean_pct:g}")
        body.append((start, *pairs, *distances))
    heads = ("start", *profile["ligaments"], "mean distance, the paper", "recomputed")
    return table(
        "Stiffness [kN] and reference strain [%] at the start, and how far from the truth",
        heads,
        body,
    )


def table_2(found: Found) -> ik.report.Table:
    """Response to each load, beside the measured one and the paper's."""
    models = {"the paper's model": np.array([x.paper_model for x in published.TABLE2])}
    models |= {name: responses(found, name) for name in knees(found)}
    body = [
        (
            f"{x.load} {x.magnitude:g} {LOAD_UNITS[x.unit]}, {x.flexion_deg:g} deg [{x.unit}]",
            f"{x.mean:.1f} ({x.sd:.1f})",
            *(f"{v[i]:.1f} ({(v[i] - x.mean) / x.sd:+.1f})" for v in models.values()),
        )
        for i, x in enumerate(published.TABLE2)
    ]
    return table(
        "Response to each load, and in brackets how many sds from the measured mean",
        ("load", "measured, mean (sd)", *models),
        body,
    )


def arc_table(found: Found) -> ik.report.Table:
    """Sums of the responses to opposite loads, which no choice of the zero can change."""
    body = []
    for flexion, (one, other) in product((0, 30, 60), OPPOSITE):
        index = {
            x.load.split()[0]: i for i, x in enumerate(published.TABLE2) if x.flexion_deg == flexion
        }
        if one not in index or other not in index:
            continue
        both = [index[one], index[other]]
        rows = [published.TABLE2[i] for i in both]
        mean, sd = sum(x.mean for x in rows), float(np.hypot(rows[0].sd, rows[1].sd))
        sums = [sum(x.paper_model for x in rows)]
        sums += [responses(found, name)[both].sum() for name in knees(found)]
        body.append(
            (
                f"{one} + {other}, {flexion} deg [{rows[0].unit}]",
                f"{mean:.1f} ({sd:.1f})",
                *(f"{x:.1f} ({(x - mean) / sd:+.1f})" for x in sums),
            )
        )
    return table(
        "The same from one load to its opposite, and how many sds from the measured mean",
        ["arc", "measured, mean (sd)", "the paper's model", *knees(found)],
        body,
    )


def table_3(found: Found) -> ik.report.Table:
    """Errors of the parameters before and after the search."""
    profile, body = profile_of(found), []
    for start, printed in PAPER.PAPER_TABLE3.items():
        before = parameter_error(profile["starts"][start], profile["truth"])
        for i, (key, unit) in enumerate((("error_kN", "kN"), ("error_pct", "%"))):
            cells = [
                median_range(spread([np.mean(x[key]) for x in PAPER.rows(part, start)]))
                for part in parts(found).values()
            ]
            exact = max(
                max(x[key])
                for part in parts(found).values()
                for x in part["least-squares"]
                if x["start"] == start
            )
            body.append(
                (
                    start,
                    f"{KINDS[i][0]} [{unit}]",
                    f"{(before.mean_kN, before.mean_pct)[i]:.2f}",
                    "{:.2f} ({:.2f})".format(*printed[i]),
                    *cells,
                    f"{exact:.0e}" if exact else "0",
                )
            )
    return table(
        "Mean absolute error over the four ligaments; ours are median [range] of the runs",
        [
            "start",
            "parameter",
            "at the start",
            "the paper, mean (sd)",
            *knees(found),
            "least squares",
        ],
        body,
    )


def table_4(found: Found) -> ik.report.Table:
    """Kinematic errors before and after the search."""
    body = []
    for s, start in enumerate(PAPER.PAPER_TABLE3):
        for coordinate, label in QUANTITIES.items():
            place = ik.laxity.COORDINATES.index(coordinate)
            cells = []
            for name, part in parts(found).items():
                errors = [x["rmse_by_flexion"] for x in PAPER.rows(part, start)]
                after = np.median(errors, axis=0)[:, place]
                cells += [angles(before_any_fit(found, name, start)[:, place]), angles(after)]
            printed = PAPER.PAPER_TABLE4[coordinate][s]
            body.append((start, label, " / ".join(f"{x:.1f}" for x in printed), *cells))
    heads = [f"{x}, {when}" for x in knees(found) for when in ("at the start", "after the search")]
    return table(
        "Kinematic error (RMSE) at 0 / 30 / 60 deg of flexion, ours medians over the runs",
        ["start", "coordinate", "the paper, after", *heads],
        body,
    )


def course_table(found: Found) -> ik.report.Table:
    """After how many simulations our searches get below the paper's errors."""
    body = []
    for start in PAPER.PAPER_TABLE3:
        printed = paper_errors(start)
        lines = [course(found, name, start) for name in knees(found)]
        cells = []
        for i, value in enumerate(printed):
            counts = [passed(n, errors[:, i], value) for n, errors in lines]
            cells.append(f"{value:.2f}: {' / '.join(counts)}")
        body.append((start, *cells))
    return table(
        f"The paper's error: simulations after which ours is below it, {pair_of(found)}",
        ["start", "stiffness [kN]", "reference strain [%]", *QUANTITIES.values()],
        body,
    )


def force_table(found: Found, by: str) -> ik.report.Table:
    """Differences of tension: the paper's, and ours from smallest to largest mistake."""
    printed = {"flexion": PAPER.PAPER_TABLE6, "scenario": PAPER.PAPER_TABLE7}[by]
    body = []
    for i, (label, paper) in enumerate(printed.items()):
        for j, ligament in enumerate(PAPER.PAPER_LIGAMENTS):
            own = [forces(found, name, by, (i, ligament)) for name in knees(found)]
            ours = (pair(x) for x in zip(*own, strict=True))
            body.append((f"{label}, {ligament}", *paper[j], *ours))
    return table(
        f"Largest difference of tension [N] by {by}; ours are {pair_of(found)}",
        ["trials, ligament", *(f"paper, {x} | 0" for x in PAPER.FORCE_STARTS), *FORCE_HEADS],
        body,
    )


def consistency_table(_: Found) -> ik.report.Table:
    """Largest entries of the paper's Tables 6 and 7, which cover the same moments."""
    body = []
    for j, ligament in enumerate(PAPER.PAPER_LIGAMENTS):
        for s, start in enumerate(PAPER.FORCE_STARTS):
            both = [
                max(row[j][s] for row in table.values())
                for table in (PAPER.PAPER_TABLE6, PAPER.PAPER_TABLE7)
            ]
            body.append((f"{ligament}, {start}", *both, both[0] - both[1]))
    return table(
        "Largest entry of each column of the paper's Tables 6 and 7 [N]",
        ["column", *(f"{x} | 0" for x in ("Table 6", "Table 7", "difference"))],
        body,
    )


FORCE_HEADS = ("small errors", "from IG1", "from IG4", "IG4, no fit", "equivalent", "tension")
KINDS = (("stiffness", "kN"), ("reference strain", "%"))


def responses(found: Found, knee: str) -> ik.runs.Array:
    """A knee's response to the loads of Table 2 [mm, deg], NaN where it has none."""
    values = part_of(found, EVALUATION, knee)["table2"]["response"]
    return np.array([np.nan if x is None else x for x in values])


def forces(found: Found, knee: str, by: str, place: tuple[int, str]) -> list[float | None]:
    """One cell of Table 6 or 7 for one knee: from small errors to equivalent sets."""
    i, ligament = place
    part, checks = parts(found)[knee], part_of(found, CHECKS, knee)
    j, key = part["profile"]["ligaments"].index(ligament), f"tension_by_{by}_N"
    runs = [max(x[key][i][j] for x in PAPER.rows(part, start)) for start in PAPER.FORCE_STARTS]
    return [
        checks["small_errors"][key][i][j],
        *runs,
        checks["before_any_fit"]["IG4"][key][i][j],
        equivalent_force(found, knee, by, place),
        part["profile"][f"largest_tension_by_{by}_N"][i][j],
    ]


def equivalent_force(found: Found, knee: str, by: str, place: tuple[int, str]) -> float | None:
    """The largest difference among sets that the paper's criterion lets pass; None if unknown."""
    record = found[EQUIVALENTS]
    if record is None or "paper" not in record["knees"].get(knee, {}).get("cases", {}):
        return None
    part = record["knees"][knee]
    values = part["cases"]["paper"]["forces"][f"by_{by}_N"][place[0]]
    value: float | None = values[part["setting"]["ligaments"].index(place[1])]
    return value


def course(found: Found, knee: str, start: str) -> tuple[list[int], ik.runs.Array]:
    """Simulations, and median errors after them: kN, %, drawer, internal, varus; the end last."""
    record = found[CHECKS]
    assert record is not None
    runs = record["knees"][knee]["course"][start]
    ends = PAPER.rows(parts(found)[knee], start)
    chosen = [ik.laxity.COORDINATES.index(x) for x in QUANTITIES]

    def medians(rows: list[Row], average: Callable[[Any], Any]) -> ik.runs.Array:
        kinematic = np.array([x["rmse_by_flexion"] for x in rows])[..., chosen].mean(axis=-2)
        own = np.array([[average(x["error_kN"]), average(x["error_pct"])] for x in rows])
        errors = np.concatenate([np.moveaxis(own, 1, -1), kinematic], axis=-1)
        return np.asarray(np.median(errors, axis=0))

    number = int(np.median([x["n_simulations"] for x in ends]))
    on_the_way, at_the_end = medians(runs, np.array), medians(ends, np.mean)
    counts = [*record["head"]["settings"]["checkpoints"], number]
    return counts, np.vstack([on_the_way, at_the_end])


def paper_errors(start: str) -> tuple[float, ...]:
    """The paper's errors in the order of `course`, kinematic ones averaged over flexion."""
    s = list(PAPER.PAPER_TABLE3).index(start)
    kinematic = (float(np.mean(PAPER.PAPER_TABLE4[x][s])) for x in QUANTITIES)
    return (*(x[0] for x in PAPER.PAPER_TABLE3[start]), *kinematic)


def passed(counts: list[int], errors: ik.runs.Array, value: float) -> str:
    """The first count with an error not above a value."""
    below = np.flatnonzero(errors <= value)
    return str(counts[below[0]]) if below.size else "never"


def before_any_fit(found: Found, knee: str, start: str) -> ik.runs.Array:
    """Kinematic errors at the start, by flexion angle and coordinate; zero for the truth itself."""
    known = part_of(found, CHECKS, knee)["before_any_fit"]
    if start not in known:
        return np.zeros((3, len(ik.laxity.COORDINATES)))
    return np.array(known[start]["rmse_by_flexion"])


def angles(values: ik.runs.Array) -> str:
    """Numbers at 0, 30 and 60 deg in one cell."""
    return " / ".join(f"{x:.2f}" for x in values)


def pair(values: tuple[float | None, ...]) -> str:
    """One number a knee in one cell."""
    return " / ".join("-" if x is None else f"{x:.0f}" for x in values)


def pair_of(found: Found) -> str:
    """The knees in the order of such a cell."""
    return " / ".join(knees(found))


def parts(found: Found) -> Mapping[str, Row]:
    """What study 02 has of each knee."""
    record = found[GUESSES]
    assert record is not None
    knees: Mapping[str, Row] = record["knees"]
    return knees


def part_of(found: Found, study: str, knee: str) -> Row:
    """What a study has of a knee."""
    record = found[study]
    assert record is not None
    part: Row = record["knees"][knee]
    return part


def knees(found: Found) -> tuple[str, ...]:
    """The knees of the page, those of study 02."""
    return tuple(parts(found))


def profile_of(found: Found) -> Row:
    """Truth, starts and names, which all knees share."""
    profile: Row = next(iter(parts(found).values()))["profile"]
    return profile


TABLE_OF: Mapping[str, tuple[Callable[[Found], ik.report.Table], tuple[str, ...]]] = {
    "table 1": (table_1, (GUESSES,)),
    "table 2": (table_2, (GUESSES, EVALUATION)),
    "arcs": (arc_table, (GUESSES, EVALUATION)),
    "table 3": (table_3, (GUESSES,)),
    "table 4": (table_4, (GUESSES, CHECKS)),
    "course": (course_table, (GUESSES, CHECKS)),
    "table 5": (lambda found: PAPER.table_5(found[GUESSES]), (GUESSES,)),
    "table 6": (lambda found: force_table(found, "flexion"), (GUESSES, CHECKS)),
    "table 7": (lambda found: force_table(found, "scenario"), (GUESSES, CHECKS)),
    "tables 6 and 7": (consistency_table, ()),
}
