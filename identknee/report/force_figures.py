"""Figures of a fit: measured forces beside those predicted, and what it has at each limit."""

import numpy as np

from identknee.checks.compared_forces import ComparedForces
from identknee.checks.limit_price import PlausibilityPrice
from identknee.report.figures import (
    BLACK,
    COLOURS,
    FIT,
    MEASURED,
    SMALL,
    Figure,
    bare,
    legend_below,
    one_panel,
    panel_rows,
    rows_down,
)
from identknee.runs.words import label

MOST_PANELS, MOST_TRIALS, IN_A_ROW = 12, 24, 3


def compared_forces_figure(forces: ComparedForces) -> Figure:
    """Measured and predicted forces by trial, a panel for each kind of them.

    Dots are measured, their bars two standard deviations. Of many the panels, and the trials of a
    panel, are shown in which both differ most.
    """
    names, away = np.array(forces.names), np.abs(forces.measured - forces.predicted) / forces.sd
    away = np.nan_to_num(away)
    kinds = list(dict.fromkeys(forces.names))
    worst = sorted(kinds, key=lambda x: -float(away[names == x].max()))[:MOST_PANELS]
    kinds = [x for x in kinds if x in worst]
    rows = [np.flatnonzero(names == x) for x in kinds]
    rows = [np.sort(x[np.argsort(-away[x], kind="stable")[:MOST_TRIALS]]) for x in rows]
    size = (3.2, 0.9 + 0.2 * max(map(len, rows)))
    figure, panels = panel_rows(len(kinds), size, (1.2, 0.6), IN_A_ROW)
    for axes, kind, own in zip(panels, kinds, rows, strict=True):
        places = np.arange(len(own))
        axes.errorbar(
            forces.measured[own], places, xerr=2.0 * forces.sd[own], fmt="o", color=MEASURED,
            markersize=3.5, elinewidth=0.9, label="measured",
        )  # fmt: skip
        axes.plot(
            forces.predicted[own], places, "s", color=FIT, markersize=6.0,
            markerfacecolor="none", label="predicted by the fit",
        )  # fmt: skip
        rows_down(axes, [forces.trials[i] for i in own])
        axes.set_xlabel(label(kind), fontsize=SMALL + 1)
        bare(axes, grid="y", labelsize=SMALL)
    legend_below(figure, *panels[0].get_legend_handles_labels())
    return figure


GREY = "0.85"
# Values beyond so many times the limit are drawn at the edge.
MOST = 3.0


def plausibility_figure(price: PlausibilityPrice) -> Figure:
    """Values of the fit and of that without limits, a row for each limit, as shares of the limit.

    Values beyond three times a limit stand at the edge with their number.
    """
    rows = price.limits
    figure, axes = one_panel(6.6, 1.3 + 0.3 * len(rows))
    places = np.arange(len(rows))
    for place, x in enumerate(rows):
        limit = x.limit
        low = 1.0 if limit.form == "within" else 1.0 - limit.spread / limit.size
        axes.plot(
            [low, 1.0 + limit.spread / limit.size], [place, place], color=GREY, linewidth=9.0,
            solid_capstyle="butt", zorder=1, label="limit" if place == 0 else None,
        )  # fmt: skip
    # What lies beyond the figure by row, both fits in one text: they may be alike.
    beyond: dict[int, list[str]] = {}
    for name, values, filled in (
        ("fit without limits", [x.value_without for x in rows], "none"),
        ("fit with limits", [x.limit.value for x in rows], COLOURS[0]),
    ):
        sizes = np.array([x.limit.size for x in rows])
        # A slack ligament has no strain.
        is_signed = np.array([x.limit.form != "within" for x in rows])
        shares = np.where(is_signed, np.maximum(values, 0.0), np.abs(values)) / sizes
        axes.plot(
            np.minimum(shares, MOST), places, "o", color=COLOURS[0], markerfacecolor=filled,
            markersize=6.0, label=name, zorder=3, clip_on=False,
        )  # fmt: skip
        for place in np.flatnonzero(shares > MOST).tolist():
            beyond.setdefault(place, []).append(f"{abs(values[place]):.0f}")
    for place, texts in beyond.items():
        axes.annotate(
            ", ".join(dict.fromkeys(texts)), (MOST, place), (-6.0, 0.0), fontsize=SMALL,
            textcoords="offset points", ha="right", va="center", color=BLACK,
        )  # fmt: skip
    axes.axvline(1.0, color=BLACK, linewidth=0.8, zorder=2)
    rows_down(axes, [_words(x.limit.name, x.limit.size) for x in rows])
    axes.set_xlim(0.0, MOST)
    axes.set_xlabel("share of the limit", fontsize=SMALL + 1)
    bare(axes, grid="x", labelsize=SMALL)
    legend_below(figure, *axes.get_legend_handles_labels())
    return figure


def _words(name: str, size: float) -> str:
    """A limit in words, with its size.

    Examples
    --------
    >>> _words("MCL.tension_N", 557.0), _words("ACL.strain_pct", 15.0)
    ('MCL force (557 N)', 'ACL strain (15 %)')
    """
    what, _, load = name.partition("@")
    owner, _, kind = what.partition(".")
    if owner == "contact":
        which = name.partition(", ")[2]
        return f"contact, medial − lateral{f', {which}' if which else ''} ({size:g} N)"
    under = f" under {load}" if load else ""
    named = "force" if kind.startswith("tension") else "strain"
    return f"{owner} {named}{under} ({size:g} {'N' if named == 'force' else '%'})"
