"""Where in the protocol a model is wrong: which coordinate, at which flexion, under which load."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.noise.noise_model import NoiseModel
from identknee.diagnosis.score.misfit import Projector
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry
from identknee.runs.words import listed

LEVEL = 0.05
N_DRAWS = 4000
UNLOADED = "no load"
# Share of the length of a shift: with less left the fitted parameters explain it.
LEAST_LEFT = 1e-6


@declared
class TrialLayout:
    """How the trials are told apart on the map of misfit.

    Raises
    ------
    ValueError
        If shapes disagree.
    """

    flexion_deg: Array = array("Flexion of each trial", "trial", unit="deg")
    loads: Array = array("Loads of each trial, in any units", "trial", "direction")
    directions: tuple[tuple[str, str], ...] = array(
        'Names of the positive and the negative direction of each load, such as ``("internal '
        'moment", "external moment")``',
        "direction",
        is_in_arrays=False,
    )
    coordinates: tuple[str, ...] = array(
        "Names of the columns of the table", "column", is_in_arrays=False
    )
    is_measured: BoolArray = array(
        "Which values there are; the m measured ones are taken row by row",
        "trial",
        "column",
        dtype=bool,
    )

    def sides(self) -> dict[str, BoolArray]:
        """Which trials have a load of each direction, shape ``(n,)``; ``"no load"`` comes last."""
        sides = {
            name: np.asarray(sign * self.loads[:, axis] > 0)
            for axis, names in enumerate(self.directions)
            for name, sign in zip(names, (1, -1), strict=True)
        }
        return {**sides, UNLOADED: np.all(self.loads == 0, axis=1)}


@declared
class CellScore:
    """Misfit of one coordinate at one flexion angle under loads of one direction."""

    coordinate: str = entry("Coordinate of the cell")
    flexion_deg: float = entry("Its flexion", unit="deg")
    direction: str = entry("Direction of its load; no load for unloaded trials")
    score: float = entry(
        "Z-score of a shift of its values, the fitted parameters free; positive where more was "
        "measured than predicted",
        unit="1",
    )
    p_value: float = entry(
        "Probability that any cell's score is as far from 0 if there is no misfit", unit="1"
    )


@declared
class Localisation:
    """The map of misfit."""

    cells: tuple[CellScore, ...] = entry(
        "All that have data and are not explained by the fitted parameters"
    )
    region: tuple[CellScore, ...] = entry(
        "The significant cells that hang together with the highest score; empty if none is"
    )
    share: float = entry(
        "Share of the excess of the objective over its expectation that would go with the region's "
        "data, 0 to 1"
    )

    @property
    def sentence(self) -> str:
        """Where the misfit is, for a person."""
        if not self.region:
            return "No region stands out."
        where = "; ".join(_places(self.region))
        return f"{self.region[0].coordinate} {where}, {self.share:.0%} of the excess".replace(
            "%", " %"
        )


def localise(
    residuals: Array, projector: Projector, noise: NoiseModel, layout: TrialLayout, *, seed: int
) -> Localisation:
    """The misfit of every coordinate, flexion angle and direction of load.

    Parameters
    ----------
    residuals
        Whitened, measured less predicted, rows of the prior included where the projector has them,
        shape ``(m,)``.
    projector
        Projector of the fit.
    noise
        Errors of the data.
    layout
        Layout of the trials.
    seed
        Seed of the draws that adjust the probabilities for the number of cells.
    """
    cells, columns = _seen(_cells(layout), projector, noise)
    scores = projector.project(residuals) @ columns
    p_values = _p_values(np.abs(scores), columns, seed)
    found = tuple(
        CellScore(
            coordinate=cell.coordinate,
            flexion_deg=cell.flexion_deg,
            direction=cell.direction,
            score=float(score),
            p_value=float(p_value),
        )
        for cell, score, p_value in zip(cells, scores, p_values, strict=True)
    )
    region = _region(found, layout)
    rows = np.zeros(len(noise.factor), dtype=bool)
    for index in region:
        rows |= cells[index].rows
    share = _share_of_excess(residuals, projector, noise, rows) if region else 0.0
    return Localisation(cells=found, region=tuple(found[i] for i in region), share=share)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cell:
    """One coordinate, flexion and direction, and which of the m values belong to it."""

    coordinate: str
    flexion_deg: float
    direction: str
    rows: BoolArray


def _cells(layout: TrialLayout) -> list[_Cell]:
    """Those that have data."""
    cells = []
    for index, coordinate in enumerate(layout.coordinates):
        for flexion in np.unique(layout.flexion_deg):
            for direction, trials in layout.sides().items():
                where = np.zeros(layout.is_measured.shape, dtype=bool)
                where[:, index] = trials & (layout.flexion_deg == flexion)
                rows = where[layout.is_measured]
                if rows.any():
                    cells.append(
                        _Cell(
                            coordinate=coordinate,
                            flexion_deg=float(flexion),
                            direction=direction,
                            rows=rows,
                        )
                    )
    return cells


def _seen(
    cells: Sequence[_Cell], projector: Projector, noise: NoiseModel
) -> tuple[list[_Cell], Array]:
    """Cells whose shift the parameters do not explain, and those shifts as columns of length 1."""
    shifts = noise.whiten(np.stack([x.rows for x in cells], axis=1).astype(np.float64))
    columns = projector.project(shifts)
    size = np.linalg.norm(columns, axis=0)
    seen = size > LEAST_LEFT * np.linalg.norm(shifts, axis=0)
    kept = [cell for cell, is_seen in zip(cells, seen, strict=True) if is_seen]
    return kept, columns[:, seen] / size[seen]


def _p_values(sizes: Array, columns: Array, seed: int) -> Array:
    """Probability that noise makes the largest score of any cell as large."""
    _, values, vectors = np.linalg.svd(columns, full_matrices=False)
    draws = np.random.default_rng(seed).standard_normal((N_DRAWS, len(values)))
    largest = np.sort(np.abs(draws @ (values[:, None] * vectors)).max(axis=1))
    above = N_DRAWS - np.searchsorted(largest, sizes)
    return np.asarray((above + 1) / (N_DRAWS + 1))


def _region(cells: Sequence[CellScore], layout: TrialLayout) -> list[int]:
    """The significant cells that hang together with the one of the highest score."""
    significant = [i for i, x in enumerate(cells) if x.p_value <= LEVEL]
    if not significant:
        return []
    angles = np.unique(layout.flexion_deg).tolist()
    axes = {name: axis for axis, names in enumerate(layout.directions) for name in names}

    def touch(one: CellScore, other: CellScore) -> bool:
        step = abs(angles.index(one.flexion_deg) - angles.index(other.flexion_deg))
        same_axis = axes.get(one.direction) == axes.get(other.direction)
        turn = int(one.direction != other.direction)
        return one.coordinate == other.coordinate and same_axis and step + turn == 1

    region = [max(significant, key=lambda i: abs(cells[i].score))]
    for reached in region:
        region += [i for i in significant if i not in region and touch(cells[reached], cells[i])]
    return sorted(region)


def _share_of_excess(
    residuals: Array, projector: Projector, noise: NoiseModel, rows: BoolArray
) -> float:
    """How much of the excess goes when the data of `rows` are left out and the rest refitted."""
    projected = projector.project(residuals)
    total = float(projected @ projected)
    excess = total - projector.degrees_of_freedom
    without = projector.with_columns(noise.whiten(np.eye(len(rows))[:, rows]))
    left = without.project(residuals)
    expected = without.rank - projector.rank
    fallen = total - float(left @ left) - expected
    return float(np.clip(fallen / excess, 0.0, 1.0)) if excess > 0 else 0.0


def _places(region: Sequence[CellScore]) -> list[str]:
    """Directions with their angles, those with the same angles in one phrase."""
    angles = {
        direction: tuple(x.flexion_deg for x in region if x.direction == direction)
        for direction in dict.fromkeys(x.direction for x in region)
    }
    places = []
    for shared in dict.fromkeys(angles.values()):
        directions = listed(x for x, own in angles.items() if own == shared)
        places.append(f"under {directions} at {listed(f'{x:g}' for x in shared)} deg")
    return places
