"""Figures of measured forces beside those predicted."""

import numpy as np

from identknee.checks.compared_forces import ComparedForces
from identknee.report.canvas import Figure
from identknee.report.figures import (
    FIT,
    MEASURED,
    SMALL,
    bare,
    legend_below,
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
