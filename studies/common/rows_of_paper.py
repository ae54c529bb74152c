"""Tables like those of the paper, with rows of our own."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from common.published import PublishedError, PublishedLaxity
from identknee.report.presenter import Cell, Column, Table
from identknee.runs.declare import Array
from identknee.verbs.demo import parameter_error


def laxity_table(published: Sequence[PublishedLaxity], models: Mapping[str, ArrayLike]) -> Table:
    """Measured laxity, the paper's model and further models, a row a load (the paper's Table 2).

    Parameters
    ----------
    published
        The rows.
    models
        By name, the response of a model to each load, positive the way it pushes [mm or deg],
        shape ``(len(published),)``; NaN where it has none.
    """
    values = [np.asarray(x, float) for x in models.values()]
    rows = tuple(
        (
            row.load,
            f"{row.magnitude:g} {'N' if row.column.endswith('_N') else 'N·m'}",
            row.flexion_deg,
            row.unit,
            f"{row.mean:.1f} ({row.sd:.1f})",
            row.paper_model,
            *(_known(value[i]) for value in values),
            *(_known((value[i] - row.mean) / row.sd) for value in values),
        )
        for i, row in enumerate(published)
    )
    return Table(
        title="Laxity under the loads of the paper's Table 2",
        columns=(
            Column(name="load"),
            Column(name="magnitude"),
            Column(name="flexion", unit="deg", decimals=0),
            Column(name="unit"),
            Column(name="measured mean (sd)"),
            Column(name="paper's model", decimals=1),
            *(Column(name=name) for name in models),
            *(Column(name=f"{name}, sd from mean") for name in models),
        ),
        rows=rows,
    )


def start_table(names: Sequence[str], starts: Mapping[str, ArrayLike], truth: ArrayLike) -> Table:
    """Initial guesses and their mean distances from the truth (the paper's Table 1).

    Parameters
    ----------
    names
        Names of the ligaments, in the order of theta.
    starts
        Theta by name, shape ``(2 m,)`` each.
    truth
        Theta they are compared with, shape ``(2 m,)``.
    """
    rows = []
    for start, theta in starts.items():
        values = np.asarray(theta, float)
        error = parameter_error(values, truth)
        pairs = values.reshape(2, -1).T.ravel().tolist()
        rows.append((start, *pairs, error.mean_kN, error.mean_pct))
    columns = [
        column
        for name in names
        for column in (
            Column(name=f"{name} stiffness", unit="kN", decimals=1),
            Column(name=f"{name} reference strain", unit="%", decimals=1),
        )
    ]
    return Table(
        title="Initial guesses and their mean distance from the reference",
        columns=(
            Column(name="start"),
            *columns,
            Column(name="stiffness distance", unit="kN", decimals=3),
            Column(name="reference strain distance", unit="%", decimals=3),
        ),
        rows=tuple(rows),
    )


def error_table(published: Sequence[PublishedError], own: Mapping[str, Array]) -> Table:
    """Published kinematic errors with our own rows below them (the paper's Table 5).

    Parameters
    ----------
    published
        The rows.
    own
        By name, errors of internal rotation [deg], varus rotation [deg] and anterior translation
        [mm], shape ``(3,)``.
    """
    rows: list[tuple[Cell, ...]] = [
        (
            row.study if row.flexion_deg is None else f"{row.study}, {row.flexion_deg:g} deg",
            *(_mean_sd(pair) for pair in (row.internal_deg, row.varus_deg, row.anterior_mm)),
        )
        for row in published
    ]
    rows += [(name, *(f"{x:.2f}" for x in values)) for name, values in own.items()]
    return Table(
        title="Kinematic error (RMSE) of models against the data they were fitted to, mean (sd)",
        columns=(
            Column(name="study"),
            Column(name="internal rotation", unit="deg"),
            Column(name="varus rotation", unit="deg"),
            Column(name="anterior translation", unit="mm"),
        ),
        rows=tuple(rows),
    )


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _mean_sd(pair: tuple[float, float | None] | None) -> str | None:
    if pair is None:
        return None
    mean, sd = pair
    return f"{mean:.1f}" if sd is None else f"{mean:.1f} ({sd:.1f})"
