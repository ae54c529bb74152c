"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scores import difference, rms, scores, within

import identknee as ik
from identknee.model.effects.facts import cause_label
from identknee.subject.plausibility import strengths_by_name

NAMES = {"s192803": "four lines", "s192803_bundles": "14 bundles"}
LINES = "s192803"
PLAIN, LIMITS, BONE = "plain", "limits", "limits, on the bone"
ERROR, BOTH = "error of the model", "limits and error of the model"
WITH_MENISCI, MENISCI = "limits, menisci", "menisci"
UNKNOWN, WITH_UNKNOWN = "structures unknown", "limits, structures unknown"
SHORT = {
    PLAIN: "plain",
    LIMITS: "limits",
    BONE: "limits, on bone",
    ERROR: "error",
    BOTH: "limits, error",
    WITH_MENISCI: WITH_MENISCI,
    UNKNOWN: "structures",
    WITH_UNKNOWN: "limits, structures",
}
COMPARED = (PLAIN, LIMITS, WITH_MENISCI, BOTH, UNKNOWN, WITH_UNKNOWN)
JUDGED = ("anterior_drawer_mm", "varus_deg", "internal_deg")
COORDINATES = ik.laxity.COORDINATES
CAPSULE = "capsule"
LABELS = {CAPSULE: "capsule of three sheets"}
DEVICE = "second device"
Row = Mapping[str, Any]


def main() -> None:
    """Draw the figures and fill the page."""
    draw_study(
        __file__,
        {
            "figure_1_forces": forces_figure,
            "figure_2_price": price_figure,
            "figure_3_held_out": held_out_figure,
            "figure_4_ends": ends_figure,
        },
        tables,
    )


def tables(record: Row) -> Mapping[str, ik.report.Table | str]:
    """What stands at each mark of the page."""
    return {
        "fits": fits_table(record),
        "unknown": unknown_table(record),
        "limits": limits_table(record),
        "structures": structures_table(record),
        "held out": held_out_table(record),
        "paired": paired_table(record),
        "second device": device_table(record),
        "ends": ends_table(record),
        "measurements": measurements_table(record),
    }


def of(record: Row, knee: str, part: str, **wanted: str) -> Row:
    """The one row of a part that is asked for."""
    rows = record["knees"][knee][part]
    return next(x for x in rows if all(x[k] == value for k, value in wanted.items()))


def fits_of(part: Row) -> list[Row]:
    """Rows of all ways to fit a knee."""
    return [*part["fits"], *part["structures_unknown"]]


def splits(part: Row) -> list[Row]:
    """Rows of all trials held out."""
    return [
        *part["held_out"],
        *part["held_out_at_0_deg"],
        *part["held_out_with_structures_unknown"],
    ]


def profiles(record: Row) -> list[Row]:
    """Rows of all profiles of the four lines."""
    part = record["knees"][LINES]
    return [*part["profiles"], *part["profiles_with_structures_unknown"]]


def predictions(record: Row, knee: str) -> Iterator[tuple[str, Row]]:
    """What was predicted, a split or the other device, and each row that has its values."""
    for x in splits(record["knees"][knee]):
        yield x["split"], x
    part = record["knees"][knee]
    for x in [*fits_of(part), *part["second_device"]]:
        yield DEVICE, {**x, "values": x["second_device"], "degrees_of_freedom": None}


def square(row: Row) -> float:
    """Deviance of table and stated errors, without that of an error of the model."""
    return float(row["terms"]["laxity table"] + row["terms"]["priors of nuisance parameters"])


def beyond(row: Row) -> float:
    """Deviance of the limits."""
    return float(row["terms"].get("limits of plausibility", 0.0))


def largest(row: Row) -> dict[str, float]:
    """Largest force of each ligament over trials."""
    return {
        name: max(x for x in values if x is not None) for name, values in row["forces_N"].items()
    }


def largest_words(row: Row, n: int = 3) -> str:
    """The ligaments whose largest forces are most of their strength."""
    found = largest(row)
    share = sorted(found, key=lambda x: -found[x] / row["strengths_N"][x][0])[:n]
    return ", ".join(
        f"{name} {found[name]:.0f} N ({100 * found[name] / row['strengths_N'][name][0]:.0f} %)"
        for name in share
    )


def errors(row: Row) -> Iterator[float]:
    """Root-mean-square errors in the order of `JUDGED`."""
    return (row["rmse"][COORDINATES.index(x)] for x in JUDGED)


def price_of(row: Row) -> float | None:
    """What the limits cost; None where there are none or it was not computed."""
    return row["price"]["price"] if "price" in row else None


def fits_table(record: Row) -> ik.report.Table:
    """Each way to fit the knee."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for x in fits_of(part):
            medial, lateral = x["mean_contact_N"]
            rows.append(
                (
                    NAMES[knee],
                    x["variant"],
                    f"{x['n_with_equilibrium']} of 24",
                    square(x),
                    beyond(x) if "limits" in x["variant"] else None,
                    price_of(x),
                    *errors(x),
                    f"{medial:.0f} / {lateral:.0f}",
                    largest_words(x),
                    len(x["implausible"]),
                )
            )
    return table(
        "Fits to 24 trials, 120 values",
        "model; fit; trials with equilibrium; table and stated errors | 0; limits | 1; price | 0; "
        "anterior drawer [mm]; varus [deg] | 1; internal rotation [deg] | 1; "
        "contact medial / lateral [N]; largest forces (share of strength); "
        "findings of an implausible fit | 0",
        rows,
    )


def unknown_table(record: Row) -> ik.report.Table:
    """What structures that are nuisances became, without and with limits."""
    fits = record["knees"][LINES]["structures_unknown"]
    limited = of(record, LINES, "structures_unknown", variant=WITH_UNKNOWN)
    strengths = {name: mean for name, (mean, _, _) in strengths_by_name().items()}
    rows: list[tuple[Cell, ...]] = [
        (
            cause_label(name),
            *(
                cell
                for x in fits
                for cell in (
                    _stiffness(x["theta"], name),
                    max(v or 0.0 for v in x["added_N"][name]),
                )
            ),
            strengths.get(name),
        )
        for name in limited["added_N"]
    ]
    return table(
        "Structures that four lines lack, as nuisance parameters",
        "structure; stiffness [kN] | 1; largest force [N] | 0; stiffness with limits [kN] | 1; "
        "largest force with limits [N] | 0; mean strength [N] | 0",
        rows,
    )


def _stiffness(theta: Mapping[str, float], name: str) -> float:
    """Stiffness of a structure, of all its lines together."""
    return sum(x for key, x in theta.items() if key.startswith(name) and key.endswith("_kN"))


def limits_table(record: Row) -> ik.report.Table:
    """What each limit costs."""
    rows: list[tuple[Cell, ...]] = [
        (
            NAMES[knee],
            x["name"],
            x["value_without"],
            x["value"],
            x["deviance"],
            x["drop_one"],
            x["alone"],
        )
        for knee in record["knees"]
        for x in of(record, knee, "fits", variant=LIMITS)["price"]["limits"]
        if max(x["drop_one"], x["alone"]) >= 1.0
    ]
    return table(
        "Limits that cost at least 1 unit of deviance",
        "model; limit [N or %]; value without limits | 0; value with them | 0; "
        "it adds itself | 1; saved without it | 1; its price alone | 1",
        rows,
    )


def label(structure: str) -> str:
    """What prose calls a structure."""
    return LABELS.get(structure) or cause_label(structure)


def structures_table(record: Row) -> ik.report.Table:
    """What a structure more changes of a fit with limits."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        base = of(record, knee, "fits", variant=LIMITS)
        for x in [base, *part["structures"]]:
            more = x["n_parameters"] - base["n_parameters"]
            whole = square(x) + beyond(x)
            price = price_of(x)
            if more and x["structure"] == "meniscus":
                (without,) = part["without_limits"]
                # A structure that does nothing fits as well as none.
                plain = of(record, knee, "fits", variant=PLAIN)
                price = whole - min(square(without), square(plain))
            medial, lateral = x["mean_contact_N"]
            rows.append(
                (
                    NAMES[knee],
                    label(x["structure"]) if more else "none",
                    more,
                    square(x),
                    beyond(x),
                    whole - square(base) - beyond(base),
                    price,
                    f"{medial:.0f} / {lateral:.0f}",
                    len(x["implausible"]),
                )
            )
    return table(
        "Fits with limits and one structure more",
        "model; structure; its parameters | 0; table and stated errors | 1; limits | 1; "
        "change of both | 1; price | 1; contact medial / lateral [N]; "
        "findings of an implausible fit | 0",
        rows,
    )


def held_out_table(record: Row) -> ik.report.Table:
    """Errors and intervals of trials held out."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for x in splits(part):
            known = [v for v in x["values"] if v[3] is not None]
            found = scores(x["values"], x["degrees_of_freedom"])
            trials = len({v[0] for v in known})
            rows.append(
                (
                    x["split"],
                    NAMES[knee],
                    x["variant"],
                    f"{trials} of {x['n_trials']}",
                    *(rms(x["judged"], name) for name in JUDGED),
                    *(rms(x["values"], name) for name in JUDGED),
                    100.0 * within(x["values"], x["degrees_of_freedom"]),
                    float(np.mean(list(found.values()))),
                )
            )
    return table(
        "Trials held out: root-mean-square errors, values in their 90 % intervals, interval score",
        "held out; model; fit; predicted; AP under AP force [mm] | 1; "
        "VV under VV moment [deg] | 1; IE under IE moment [deg] | 1; AP, all [mm] | 1; "
        "VV, all [deg] | 1; IE, all [deg] | 1; "
        "in 90 % interval [%] | 0; interval score [noise] | 1",
        rows,
    )


def paired(record: Row) -> Iterator[tuple[str, str, str, tuple[float, float, float]]]:
    """Knee, what was predicted, fit, and its score less that of the plain one with an interval."""
    for knee in record["knees"]:
        found = list(predictions(record, knee))
        plain = {what: x for what, x in found if x["variant"] == PLAIN}
        for what, x in found:
            if x["variant"] in COMPARED[1:]:
                pair = (scores(y["values"], y["degrees_of_freedom"]) for y in (x, plain[what]))
                yield knee, what, x["variant"], difference(*pair)


def paired_table(record: Row) -> ik.report.Table:
    """Scores against that of the plain fit."""
    rows: list[tuple[Cell, ...]] = [
        (what, NAMES[knee], variant, f"{mean:.2f} ({low:.2f} to {high:.2f})", _said(low, high))
        for knee, what, variant, (mean, low, high) in paired(record)
    ]
    return table(
        "Interval score less that of the plain fit, 95 % by paired bootstrap over trials",
        "predicted; model; fit; difference [noise]; the fit is",
        rows,
    )


def _said(low: float, high: float) -> str:
    return "better" if high < 0.0 else "worse" if low > 0.0 else "no difference shown"


def device_table(record: Row) -> ik.report.Table:
    """Changes on the other device."""
    rows: list[tuple[Cell, ...]] = []
    for knee in record["knees"]:
        for what, x in predictions(record, knee):
            if what != DEVICE or x["variant"] not in COMPARED:
                continue
            found = x["values"]
            known = [v for v in found if v[3] is not None]
            rows.append(
                (
                    NAMES[knee],
                    x["variant"],
                    f"{len(known)} of {len(found)}",
                    *(rms(found, begin=name) for name in ("Anterior", "External", "Internal")),
                    100.0 * within(found, None),
                    float(np.mean(list(scores(found, None).values()))),
                )
            )
    return table(
        "Second device near 30 deg: changes of the coordinate under load, from the unloaded trial",
        "model; fit; predicted; anterior [mm] | 1; external [deg] | 1; internal [deg] | 1; "
        "in 90 % interval [%] | 0; interval score [noise] | 1",
        rows,
    )


def ends_table(record: Row) -> ik.report.Table:
    """Interval of each parameter and what makes its ends."""
    part = {x["variant"]: x for x in profiles(record)}
    names = list(next(iter(part.values()))["parameters"])
    rows = [
        (parameter_label(x), *(ends_words(y["parameters"][x]) for y in part.values()))
        for x in names
    ]
    return table("95 % profile intervals of the four lines", ["parameter", *part], rows)


def ends_words(x: Row) -> str:
    """An interval in words, with what makes its ends where that is not the data."""
    return " to ".join(
        "open" if end is None else f"{end:.3g}{_maker(made)}"
        for end, made in zip(x["ends"], x["made_by"], strict=True)
    )


def _maker(made_by: str | None) -> str:
    if made_by == "data":
        return ""
    if made_by is None:
        return " (undecided)"
    owner, _, kind = str(made_by).removeprefix("bound of ").rpartition(".")
    return f" ({made_by})" if not owner else f" (bound of {owner} {_kind(kind)})"


def _kind(kind: str) -> str:
    return "stiffness" if kind.endswith("_kN") else "strain"


def parameter_label(name: str) -> str:
    """Owner, kind and unit of a parameter."""
    owner, _, kind = name.rpartition(".")
    return f"{owner} {_kind(kind)} [{'kN' if kind.endswith('_kN') else '%'}]"


def measurements_table(record: Row) -> ik.report.Table:
    """Fits without limits to one measured force more."""
    rows: list[tuple[Cell, ...]] = []
    plain, limits = (of(record, LINES, "fits", variant=x) for x in (PLAIN, LIMITS))
    for x in (plain, *record["knees"][LINES]["measurements"], limits):
        medial, lateral = x["mean_contact_N"]
        forces = x.get("forces")
        what = (
            x.get("variant")
            or ", ".join(
                f"{name.rpartition('_')[0].replace('.', ' ')} {value:.0f} N"
                for name, value in forces.items()
            )
            + f" in {x['trial'].replace('_', ' at ')} deg"
        )
        rows.append(
            (
                what,
                square(x),
                *errors(x),
                f"{medial:.0f} / {lateral:.0f}",
                largest_words(x),
                len(x["implausible"]),
            )
        )
    return table(
        "Four lines fitted without limits to one measurement more, as the believable knee has it",
        "measured beside the table; table and stated errors | 0; anterior drawer [mm]; "
        "varus [deg] | 1; internal rotation [deg] | 1; contact medial / lateral [N]; "
        "largest forces (share of strength); findings of an implausible fit | 0",
        rows,
    )


def forces_figure(record: Row) -> Figure:
    """Largest forces as shares of strength, and contact, of each fit."""
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    panels = figure.subplots(len(NAMES), 2, width_ratios=[3.0, 2.0])
    for (left, right), (knee, part) in zip(panels, record["knees"].items(), strict=True):
        menisci = next(x for x in part["structures"] if x["structure"] == "meniscus")
        made = {x["variant"]: x for x in fits_of(part)} | {WITH_MENISCI: menisci}
        fits = {x: made[x] for x in COMPARED if x in made}
        names = list(made[PLAIN]["forces_N"])
        for variant, x in fits.items():
            found, k = largest(x), COMPARED.index(variant)
            share = [found[name] / x["strengths_N"][name][0] for name in names]
            left.plot(
                share,
                np.arange(len(names)) + 0.12 * (k - 2.5),
                linestyle="none",
                marker=ik.report.MARKERS[k],
                color=ik.report.COLOURS[k],
                label=SHORT[variant],
            )
        left.axvline(1.0, color=ik.report.GREY, linewidth=1.0)
        left.set_yticks(range(len(names)), names)
        left.invert_yaxis()
        left.set_xlim(0.0, None)
        left.set_xlabel("largest force, as a share of the mean strength")
        left.set_title(NAMES[knee], fontsize=10)
        _contact_bars(right, fits)
        for axes in (left, right):
            axes.spines[["top", "right"]].set_visible(False)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _contact_bars(axes: Axes, fits: Mapping[str, Row]) -> None:
    places = np.arange(len(fits))
    colours = [ik.report.COLOURS[COMPARED.index(x)] for x in fits]
    medial, lateral = np.array([x["mean_contact_N"] for x in fits.values()]).T
    axes.barh(places, -medial, color=colours)
    axes.barh(places, lateral, color=colours)
    axes.axvline(0.0, color=ik.report.BLACK, linewidth=0.8)
    axes.set_yticks(places, [SHORT[x] for x in fits])
    axes.invert_yaxis()
    reach = 1.05 * max(medial.max(), lateral.max())
    axes.set_xlim(-reach, 0.6 * reach)
    ticks = [x for x in axes.get_xticks() if -reach <= x <= 0.6 * reach]
    axes.set_xticks(ticks, [f"{abs(x):.0f}" for x in ticks])
    axes.set_xlabel("contact force: medial, lateral [N]")


def price_figure(record: Row) -> Figure:
    """Deviance with limits, with each structure more."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    panels = figure.subplots(1, len(NAMES), width_ratios=[3.0, 2.0])
    for axes, (knee, part) in zip(panels, record["knees"].items(), strict=True):
        plain, base = (of(record, knee, "fits", variant=x) for x in (PLAIN, LIMITS))
        rows = [plain, base, *part["structures"]]
        labels = [
            "no limits",
            "limits",
            *(f"+ {label(x['structure'])}" for x in part["structures"]),
        ]
        places = np.arange(len(rows))
        of_data, of_limits = [square(x) for x in rows], [beyond(x) for x in rows]
        axes.barh(places, of_data, color=ik.report.COLOURS[0], label="table and stated errors")
        axes.barh(places, of_limits, left=of_data, color=ik.report.COLOURS[1], label="limits")
        axes.axvline(square(plain), color=ik.report.GREY, linewidth=1.0)
        axes.set_yticks(places, labels)
        axes.invert_yaxis()
        axes.set_xlabel("deviance of the best fit")
        axes.set_title(NAMES[knee], fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def held_out_figure(record: Row) -> Figure:
    """Share of values in 90 % intervals and interval score, of each prediction."""
    figure = Figure(figsize=(10.0, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    found = [(knee, *x) for knee in record["knees"] for x in predictions(record, knee)]
    groups = list(dict.fromkeys((knee, what) for knee, what, _ in found))
    left.axvspan(85.0, 97.0, color=ik.report.GREY, alpha=0.25, linewidth=0.0)
    for k, variant in enumerate(COMPARED):
        own = [
            (groups.index((knee, what)), x["values"], x["degrees_of_freedom"])
            for knee, what, x in found
            if x["variant"] == variant
        ]
        places = [place + 0.12 * (k - 2.5) for place, _, _ in own]
        shares = [100.0 * within(values, degrees) for _, values, degrees in own]
        means = [np.mean(list(scores(values, degrees).values())) for _, values, degrees in own]
        for axes, x in ((left, shares), (right, means)):
            axes.plot(
                x,
                places,
                linestyle="none",
                marker=ik.report.MARKERS[k],
                color=ik.report.COLOURS[k],
                label=SHORT[variant],
            )
    left.set_yticks(range(len(groups)), [f"{NAMES[knee]}, {what}" for knee, what in groups])
    left.invert_yaxis()
    left.set_xlabel("values in their 90 % intervals [%]")
    left.set_xlim(None, 101.0)
    right.set_xlabel("interval score [noise]; low is good")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def ends_figure(record: Row) -> Figure:
    """Profile intervals of the four lines; an open end is an arrow."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    part = profiles(record)
    names = list(part[0]["parameters"])
    kinds = [[x for x in names if x.endswith(end)] for end in ("_kN", "_pct")]
    bounds, middle = ((0.0, 40.0), (-40.0, 40.0)), 0.5 * (len(part) - 1)
    for axes, own, (low, high), unit in zip(
        figure.subplots(1, 2),
        kinds,
        bounds,
        ("stiffness [kN]", "reference strain [%]"),
        strict=True,
    ):
        for k, x in enumerate(part):
            for place, name in enumerate(own):
                _interval(axes, x["parameters"][name], place + 0.26 * (k - middle), k, (low, high))
            axes.plot(
                [],
                [],
                color=ik.report.COLOURS[k],
                marker=ik.report.MARKERS[k],
                label=SHORT[x["variant"]],
            )
        axes.set_yticks(range(len(own)), [x.rpartition(".")[0] for x in own])
        axes.set_ylim(len(own) - 0.5, -0.5)
        axes.set_xlim(low - 0.05 * (high - low), high + 0.05 * (high - low))
        axes.set_xlabel(unit)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(part)
    )
    return figure


def _interval(axes: Axes, row: Row, place: float, k: int, bounds: tuple[float, float]) -> None:
    """One interval; an open end goes a little beyond the bound, where a best fit may be."""
    colour, room = ik.report.COLOURS[k], 0.03 * (bounds[1] - bounds[0])
    beyond = (bounds[0] - room, bounds[1] + room)
    ends = [x if end is None else end for end, x in zip(row["ends"], beyond, strict=True)]
    axes.plot(ends, [place, place], color=colour)
    for end, at, sign in zip(row["ends"], ends, ("<", ">"), strict=True):
        axes.plot([at], [place], marker=sign if end is None else "|", color=colour)
    axes.plot([row["best"]], [place], marker=ik.report.MARKERS[k], color=colour, markersize=5)


if __name__ == "__main__":
    main()
