"""Figures of local geometry, one function a figure, in the style of `identknee.report.figures`."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from identknee.identify.information import Information
from identknee.report.figures import COLOURS, GREY, MARKERS, SMALL, bare
from identknee.runs.words import label_without_unit


def spectrum_figure(found: Mapping[str, Information]) -> Figure:
    """Eigenvalues of the information from stiff to sloppy, each above its noise floor.

    Parameters
    ----------
    found
        Informations in the same units by name.
    """
    figure = Figure(figsize=(1.6 + 2.0 * len(found), 4.4), layout="constrained")
    axes = figure.add_subplot()
    for k, (name, each) in enumerate(found.items()):
        x = k + np.linspace(-0.3, 0.3, each.theta.size)
        axes.plot(x, each.eigenvalues, MARKERS[k], color=COLOURS[k], label=name)
        axes.plot(x, each.floors, "_", color=GREY, markersize=9)
        for place, value, floor in zip(x, each.eigenvalues, each.floors, strict=True):
            axes.plot([place, place], [floor, value], color="0.88", linewidth=1.0, zorder=0)
        sizes = f"{each.n_above_noise} of {each.theta.size} above noise\ncondition number"
        axes.annotate(
            f"{sizes} {each.condition:.3g}",
            (k, float(each.eigenvalues[0])),
            xytext=(0, 8),
            textcoords="offset points",
            ha="center",
            fontsize=SMALL,
        )
    axes.plot([], [], "_", color=GREY, markersize=9, label="noise floor")
    axes.set_yscale("log")
    axes.margins(y=0.12)
    axes.set_xticks(range(len(found)), list(found))
    axes.set_xlim(-0.6, len(found) - 0.4)
    scaling = next(iter(found.values())).scaling
    unit = {"typical": "typical step", "prior": "prior sd"}[scaling]
    axes.set_ylabel(f"eigenvalue of the information [per squared {unit}]")
    axes.grid(axis="y", color="0.92")
    axes.set_axisbelow(True)
    bare(axes)
    return figure


def eigenvectors_figure(found: Information) -> Figure:
    """Share of every parameter in every eigenvector, from stiff to sloppy, as a heat map."""
    n = found.theta.size
    figure = Figure(figsize=(2.6 + 0.62 * n, 1.6 + 0.42 * n), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(found.eigenvectors, cmap="PuOr", vmin=-1.0, vmax=1.0, aspect="auto")
    for i in range(n):
        for j in range(n):
            share = found.eigenvectors[i, j]
            if abs(share) >= 0.1:
                axes.text(
                    j,
                    i,
                    f"{share:+.2f}".replace("0.", "."),
                    ha="center",
                    va="center",
                    fontsize=SMALL,
                    color="white" if abs(share) > 0.7 else "black",
                )
    axes.set_yticks(range(n), [label_without_unit(x) for x in found.parameter_names])
    axes.set_xticks(
        range(n),
        [
            (f"{value:.0f}" if 10.0 <= value < 1e5 else f"{value:.2g}")
            for value in found.eigenvalues
        ],
    )
    axes.set_xlabel("eigenvalue, stiff to sloppy")
    figure.colorbar(image, ax=axes, label="share of one scaled unit")
    return figure
