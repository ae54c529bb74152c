"""Tables of the page, from the record."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from common.page import table

import identknee as ik
from identknee.model.effects.facts import cause_label
from identknee.runs.words import label

PAPER = "the paper's model"
PUBLISHED = "as printed (0.4 to 4.6)"
SHOWN_SD = 1.0
# Four ligaments each, so that their tables have the same columns.
SHOWN_KNEES = ("reference", "lenhart2015_stable")
Row = Mapping[str, Any]


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables by the mark of their place on the page."""
    return {
        "table 1": gap_table(record),
        "table 2": size_table(record),
        "table 3": verdict_table(record),
        "table 3b": odd_study_table(record),
        "table 4": gain_table(record),
        "table 5": visible_table(record),
        "table 6": parameter_table(record),
    }


def responses(record: Row) -> dict[str, ik.runs.Array]:
    """Each model's response to the 13 loads [mm, deg]; NaN where it has none."""
    found = {PAPER: numbers([x["paper_model"] for x in record["rows"]])}
    for name, part in record["knees"].items():
        found[name] = numbers(part["as_it_is"]["values"])
    return found


def gaps(record: Row) -> dict[str, ik.runs.Array]:
    """The same less the measured means, in between-subject sds."""
    mean, sd = (numbers([x[key] for x in record["rows"]]) for key in ("mean", "sd"))
    return {name: (values - mean) / sd for name, values in responses(record).items()}


def gap_table(record: Row) -> ik.report.Table:
    """Measured laxity and what each model gives, with the gap in sds."""
    values, sizes = responses(record), gaps(record)
    rows = tuple(
        (
            f"{x['load']} {x['magnitude']:g} {'N' if x['unit'] == 'mm' else 'N·m'}",
            f"{x['flexion_deg']:g}",
            x["unit"],
            f"{x['mean']:.1f} ({x['sd']:.1f})",
            *(_with_gap(values[name][i], sizes[name][i]) for name in values),
        )
        for i, x in enumerate(record["rows"])
    )
    heads = ("load", "flexion [deg]", "unit", "measured mean (sd)", *values)
    return table(
        "Laxity before any fit; in brackets the distance from the mean in between-subject sds",
        heads,
        rows,
    )


def size_table(record: Row) -> ik.report.Table:
    """The gap of each model in a few numbers."""
    mean = numbers([x["mean"] for x in record["rows"]])
    units = np.array([x["unit"] for x in record["rows"]])
    rows = []
    for name, sizes in gaps(record).items():
        known = ~np.isnan(sizes)
        left = responses(record)[name] - mean
        mm, deg = (_root_mean(left[known & (units == x)]) for x in ("mm", "deg"))
        rows.append(
            (
                name,
                int(known.sum()),
                mm,
                deg,
                _root_mean(sizes[known]),
                int((np.abs(sizes[known]) > 1).sum()),
                int((np.abs(sizes[known]) > 2).sum()),
            )
        )
    return table(
        "Size of the gap before any fit",
        "model; values | 0; RMS [mm]; RMS [deg]; RMS [sd]; beyond 1 sd | 0; beyond 2 sd | 0",
        rows,
    )


def verdict_table(record: Row) -> ik.report.Table:
    """What `diagnose` says at each assumed sd."""
    return _verdicts("Verdict by the assumed sd of the measured means", list(_diagnoses(record)))


def odd_study_table(record: Row) -> ik.report.Table:
    """The same without the one value that disagrees with another study."""
    return _verdicts(
        "Verdict without external rotation at 20 deg",
        list(_diagnoses(record, "without_odd_study")),
    )


def _verdicts(title: str, found: list[tuple[str, Row]]) -> ik.report.Table:
    rows = tuple(
        (
            knee,
            size_label(x["assumed_sd"]),
            x["base"]["chi_square"],
            x["degrees_of_freedom"],
            f"{x['p_value']:.2g}",
            x["verdict"],
            ", ".join(map(cause_label, x["group"])) or "-",
            x["max_score_quantile"],
        )
        for knee, x in found
    )
    return table(
        title,
        "knee; assumed sd [mm, deg]; chi-square after the fit | 1; "
        "degrees of freedom, priors counted | 0; p; verdict; causes still open; "
        "5 % quantile of the largest score",
        rows,
    )


def gain_table(record: Row) -> ik.report.Table:
    """What the extensions gain when each value is predicted from the twelve others."""
    rows = []
    for knee, x in _diagnoses(record):
        size = size_label(x["assumed_sd"])
        rows.append(
            (knee, size, "none", x["base"]["outcome"], None, "-", *_held(x["left_out"]), None)
        )
        for its in x["extensions"]:
            amounts = "; ".join(_amount(y) for y in its["amplitudes"])
            gain = None if its["elpd_gain_se"] is None else its["elpd_gain"]
            text = None if gain is None else f"{gain:.1f} ({its['elpd_gain_se']:.1f})"
            names = " and ".join(map(cause_label, its["names"]))
            evidence = its["log_evidence_gain"]
            rows.append(
                (
                    knee,
                    size,
                    names,
                    its["outcome"],
                    evidence,
                    amounts,
                    *_held(its["left_out"]),
                    text,
                )
            )
    return table(
        "Each value predicted from the twelve others, without and with a cause",
        "knee; assumed sd [mm, deg]; cause added; fit ended in; log evidence gained | 1; "
        "amplitude (95 %); values predicted | 0; RMSE left out [mm]; RMSE left out [deg]; "
        "RMSE over assumed sd; expected RMSE over assumed sd; log predictive density gained (se)",
        rows,
    )


def visible_table(record: Row) -> ik.report.Table:
    """The amplitudes that 13 values would show, at one assumed sd."""
    found = {
        knee: {y["name"]: y for y in x["visible"]}
        for knee, x in _diagnoses(record)
        if x["assumed_sd"] == SHOWN_SD and knee in SHOWN_KNEES
    }
    first = next(iter(found.values()))
    rows = tuple(
        (
            cause_label(name),
            label(y["parameter"]),
            f"{y['relevant']:g}",
            *(_detectable(x[name]["detectable"]) for x in found.values()),
            *(_detectable(x[name]["power"]) for x in found.values()),
        )
        for name, y in first.items()
    )
    return table(
        "What 13 values with an sd of 1 mm and 1 deg can show",
        [
            *("effect", "amplitude", "smallest relevant"),
            *(f"found in 9 of 10, {knee}" for knee in found),
            *(f"share found at the smallest relevant size, {knee}" for knee in found),
        ],
        rows,
    )


def parameter_table(record: Row) -> ik.report.Table:
    """How much of each prior's width the values leave, and how many parameters they fix."""
    found = [(knee, x) for knee, x in _diagnoses(record) if knee in SHOWN_KNEES]
    names = found[0][1]["base"]["parameters"]
    rows = tuple(
        (
            knee,
            size_label(x["assumed_sd"]),
            x["base"]["effective_parameters"],
            *x["base"]["sd_over_prior"],
        )
        for knee, x in found
    )
    return table(
        "Standard deviation of each parameter after the fit over that of its prior",
        ["knee", "assumed sd [mm, deg]", "parameters the values fix | 1", *map(label, names)],
        rows,
    )


def size_label(sd: float | None) -> str:
    """An assumed standard deviation in words."""
    return PUBLISHED if sd is None else f"{sd:g}"


def numbers(values: list[float | None]) -> ik.runs.Array:
    """As an array, NaN for None."""
    return np.array([np.nan if x is None else x for x in values], dtype=np.float64)


def _diagnoses(record: Row, key: str = "diagnoses") -> Iterator[tuple[str, Row]]:
    for name, part in record["knees"].items():
        for found in part.get(key, []):
            if found["verdict"] is not None:
                yield name, found


def _held(its: Row) -> tuple[float, ...]:
    return (
        its["n_scored"],
        its["rmse_mm"],
        its["rmse_deg"],
        its["rmse_noise"],
        its["expected_noise"],
    )


def _amount(its: Row) -> str:
    unit = "" if its["unit"] == "1" else f" {its['unit']}"
    low, high = ("open" if x is None else f"{x:.2g}" for x in its["ci95"])
    return f"{its['value']:.2g}{unit} ({low} to {high})"


def _with_gap(value: float, size: float) -> str:
    return "folds" if np.isnan(value) else f"{value:.1f} ({size:+.1f})"


def _detectable(value: float | None) -> str:
    return "never" if value is None else f"{value:.2g}"


def _root_mean(values: ik.runs.Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None
