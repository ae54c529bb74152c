"""The part of residuals that fitted parameters cannot explain, and whether it looks like noise."""

from collections.abc import Sequence

import numpy as np
import scipy
from scipy.spatial.distance import cdist
from scipy.special import gammaincc, gammaln, log_ndtr, ndtri_exp

from identknee.diagnosis.noise_model import NoiseModel
from identknee.runs.declare import Array, BoolArray, array, declared, entry
from identknee.runs.words import listed

# Share of the largest singular value. Directions the data hardly see are kept on purpose: each
# costs one degree of freedom and makes every statistic indifferent to which near-equivalent fit was
# found.
LEAST_SINGULAR_VALUE = 1e-6
# Largest probability in Cauchy's combination, which is undefined at 1.
MOST_PROBABLE = 0.99
# Where the incomplete gamma function is close to the smallest number, its expansion is exact
# enough.
LEAST_TAIL = 1e-280
# Lengths of smooth misfit over the range of flexion and over the largest load of each kind. Of the
# pairs tried, one that separated 76 right names well from 21 given to causes no library lists.
FLEXION_LENGTH, LOAD_LENGTH = 2.0, 0.5
# Places that determine such a process, and the share of its largest variance that is left out.
MOST_PLACES, LEAST_VARIANCE = 300, 1e-8


@declared
class Projector:
    """The projection onto what the fitted parameters cannot explain."""

    basis: Array = array(
        "Orthonormal columns of what they can explain. The m rows are the whitened data, followed "
        "by the rows of the prior where there is one",
        "row",
        "direction",
    )

    @property
    def n_rows(self) -> int:
        """Rows, those of the prior included."""
        return len(self.basis)

    @property
    def rank(self) -> int:
        """Number of directions projected out."""
        return int(self.basis.shape[1])

    @property
    def degrees_of_freedom(self) -> int:
        """Residual degrees of freedom."""
        return self.n_rows - self.rank

    def padded(self, values: Array) -> Array:
        """`values` with rows of zeros for the prior where those rows are missing.

        Parameters
        ----------
        values
            Shape ``(m,)`` or ``(m, k)`` or, of the data rows alone, fewer rows.
        """
        missing = self.n_rows - len(values)
        return np.concatenate([values, np.zeros((missing, *values.shape[1:]))])

    def project(self, values: Array) -> Array:
        """`values` projected off the fitted parameters."""
        rows = self.padded(values)
        projected: Array = rows - self.basis @ (self.basis.T @ rows)
        return projected

    def with_columns(self, columns: Array) -> "Projector":
        """The projector that takes out `columns` too, shape ``(m, k)`` as in `padded`."""
        # Twice, so that little is left of the basis also where little is left of a column.
        left = self.project(self.project(columns))
        # A basis of `columns`, each compared with the size it had before any projection.
        sizes = np.linalg.norm(columns, axis=0)
        seen = np.linalg.norm(left, axis=0) > LEAST_SINGULAR_VALUE * sizes
        if not seen.any():
            return self
        basis, size, _ = np.linalg.svd(left[:, seen] / sizes[seen], full_matrices=False)
        new = basis[:, size > LEAST_SINGULAR_VALUE * size[0]]
        return Projector(basis=np.hstack([self.basis, new]))


def base_projector(jacobian: Array) -> Projector:
    """The projector that belongs to a fit.

    Parameters
    ----------
    jacobian
        Derivatives of the whitened predictions by the fitted parameters, followed by the rows of
        their prior, ``[J; C0^(-1/2)]``, shape ``(m, p)``. Every direction is taken out whose
        singular value is more than 1e-6 of the largest, columns scaled to length 1.
    """
    return Projector(basis=np.zeros((len(jacobian), 0))).with_columns(jacobian)


@declared
class ResidualTest:
    """One test of residuals."""

    statistic: float = entry("A chi-square, or an F ratio", unit="1")
    degrees_of_freedom: int = entry("Degrees of freedom of it, or of its numerator", unit="1")
    p_value: float = entry("Probability of one as large if the residuals are noise", unit="1")


def omnibus_check(
    residuals: Array, projector: Projector, *, noise_degrees: float = np.inf
) -> ResidualTest:
    """Whether the residuals are larger than noise.

    Parameters
    ----------
    residuals
        Whitened, rows of the prior included where the projector has them, shape ``(m,)``.
    projector
        Projector of the fit.
    noise_degrees
        Degrees of freedom of the noise's standard deviation where that is an estimate.
    """
    projected = projector.project(residuals)
    degrees = projector.degrees_of_freedom
    return chi2_or_f_test(float(projected @ projected), degrees, noise_degrees)


def nested_check(
    residuals: Array,
    projector: Projector,
    wider: Projector,
    *,
    noise_degrees: float = np.inf,
) -> ResidualTest:
    """Whether the residuals hold more of certain patterns than noise does.

    Parameters
    ----------
    residuals
        As in `omnibus_check`.
    projector
        Projector of the fit.
    wider
        The same with the whitened patterns taken out too, ``projector.with_columns(patterns)``:
        `smooth_patterns` for smooth misfit of any kind.
    noise_degrees
        As in `omnibus_check`.

    Raises
    ------
    ValueError
        If the fitted parameters explain every pattern.

    References
    ----------
    J. Neyman, "Smooth test" for goodness of fit, Scand. Actuar. J. (1937) 149-199,
    doi:10.1080/03461238.1937.10404821.
    """
    rank = wider.rank - projector.rank
    if rank == 0:
        raise ValueError("the fitted parameters explain every pattern; nothing is left to test")
    whole, left = projector.project(residuals), wider.project(residuals)
    squares_left = float(left @ left)
    return chi2_or_f_test(float(whole @ whole) - squares_left, rank, noise_degrees)


def smooth_patterns(loads: Array, flexion: Array, is_measured: BoolArray) -> Array:
    """Patterns smooth in load and flexion, for each coordinate, not whitened, shape ``(m, k)``.

    Along each kind of load ``m, |m|, m^2, sgn m`` and whether there is any, times powers of the
    flexion up to its square, so that unlisted misfit is seen too.

    Parameters
    ----------
    loads
        Loads of each trial, shape ``(n, a)``, in any units.
    flexion
        Flexion of each trial, shape ``(n,)``.
    is_measured
        Which values there are, shape ``(n, 5)``; the m measured ones are taken row by row.
    """
    along = [np.ones(len(loads))]
    for load in loads.T[np.any(loads != 0, axis=0)]:
        scaled = load / np.abs(load).max()
        along += [scaled, np.abs(scaled), scaled**2, np.sign(load), np.sign(load) ** 2]
    middle = (flexion.max() + flexion.min()) / 2
    half = max(float(np.ptp(flexion)) / 2, np.finfo(np.float64).tiny)
    powers = np.vander((flexion - middle) / half, min(len(np.unique(flexion)), 3))
    trials = np.einsum("na,np->nap", np.stack(along, axis=1), powers).reshape(len(loads), -1)
    # Patterns of trials, shape ``(n, k)``, in each coordinate alone, measured rows only.
    whole = np.einsum("nk,ij->nijk", trials, np.eye(is_measured.shape[1]))
    rows = np.asarray(whole[is_measured]).reshape(int(is_measured.sum()), -1)
    return np.asarray(rows[:, rows.any(axis=0)])


def process_errors(loads: Array, flexion: Array, is_measured: BoolArray, sd: Array) -> Array:
    """Independent errors of smooth Gaussian processes, not whitened, shape ``(m, k)``.

    Each kind of load has a process in each coordinate, which adds to the trials that have such a
    load. Its covariance, ``columns @ columns.T``, is squared-exponential, as large as the noise of
    each value, with lengths of twice the range of flexion and of half the largest load.

    Parameters
    ----------
    loads
        Loads of each trial, shape ``(n, a)``, in any units.
    flexion
        Flexion of each trial, shape ``(n,)``.
    is_measured
        Which values there are, shape ``(n, 5)``; the m measured ones are taken row by row.
    sd
        Noise of each of those, shape ``(m,)``.
    """
    along = flexion / max(float(np.ptp(flexion)), 1.0) / FLEXION_LENGTH
    trials = [np.zeros((len(loads), 0))]
    for load in loads.T[np.any(loads != 0, axis=0)]:
        whole = np.c_[along, load / np.abs(load).max() / LOAD_LENGTH]
        # The process is so smooth that its values at some places determine it everywhere.
        places = np.unique(whole[load != 0], axis=0)
        places = places[np.random.default_rng(0).permutation(len(places))[:MOST_PLACES]]
        values, vectors = np.linalg.eigh(_smooth_covariance(places, places))
        is_kept = values > LEAST_VARIANCE * values[-1]
        process = _smooth_covariance(whole, places) @ vectors[:, is_kept] / np.sqrt(values[is_kept])
        trials.append(np.where(load[:, None] != 0, process, 0.0))
    trial, coordinate = np.nonzero(is_measured)
    own = coordinate[:, None] == np.unique(coordinate)
    columns = np.einsum("m,mk,mj->mjk", sd, np.hstack(trials)[trial], own)
    return np.asarray(columns.reshape(len(trial), -1))


def _smooth_covariance(at: Array, others: Array) -> Array:
    return np.asarray(np.exp(-0.5 * cdist(at, others, "sqeuclidean")))


def process_check(
    residuals: Array, projector: Projector, errors: Array, *, noise_degrees: float = np.inf
) -> ResidualTest:
    """Whether the residuals hold more of Gaussian processes than noise does.

    The score test of their variance: the sum of squares of the residuals along their errors. It
    finds a little smooth misfit that a test of all patterns alike does not: the smoothest count
    most. Its probability is 1 where the fitted parameters explain the processes.

    Parameters
    ----------
    residuals, projector, noise_degrees
        As in `nested_check`.
    errors
        Independent errors of the processes, whitened, shape ``(m, k)``.

    References
    ----------
    G. E. P. Box, Some theorems on quadratic forms applied in the study of analysis of variance
    problems, Ann. Math. Stat. 25 (1954) 290-302, doi:10.1214/aoms/1177728786, theorem 3.1.
    """
    left = projector.project(errors)
    weights = np.linalg.eigvalsh(left.T @ left)
    if not weights.sum() > LEAST_LEFT**2 * float(np.sum(errors**2)):
        return ResidualTest(statistic=0.0, degrees_of_freedom=0, p_value=1.0)
    mean, squares = float(weights.sum()), float(np.sum(weights**2))
    along = left.T @ projector.project(residuals)
    square = float(along @ along) * mean / squares
    return chi2_or_f_test(square, mean**2 / squares, noise_degrees)


def cauchy_combination(p_values: Sequence[float]) -> float:
    """One probability from several that may depend on one another.

    References
    ----------
    Y. Liu and J. Xie, Cauchy combination test, J. Am. Stat. Assoc. 115 (2020) 393-402,
    doi:10.1080/01621459.2018.1554485.

    Examples
    --------
    >>> round(cauchy_combination([0.001, 0.5]), 4)
    0.002
    """
    used = np.clip(p_values, np.finfo(np.float64).tiny, MOST_PROBABLE)
    # The upper tail by the cotangent, exact also where probabilities are tiny.
    mean = float(np.mean(1 / np.tan(np.pi * used)))
    return float(np.arctan2(1.0, mean) / np.pi)


def chi2_or_f_test(square: float, degrees: float, noise_degrees: float) -> ResidualTest:
    """Whether a sum of squares is larger than noise: chi-square, or F for an estimated noise."""
    if np.isinf(noise_degrees):
        p_value = float(scipy.stats.chi2.sf(square, degrees))
        return ResidualTest(statistic=square, degrees_of_freedom=round(degrees), p_value=p_value)
    ratio = square / degrees
    p_value = float(scipy.stats.f.sf(ratio, degrees, noise_degrees))
    return ResidualTest(statistic=ratio, degrees_of_freedom=round(degrees), p_value=p_value)


def log_chi2_tail(value: Array, degrees: float) -> Array:
    """The log probability that a chi-square variable exceeds `value`.

    Parameters
    ----------
    value
        Any shape; 0 is returned below 0.
    degrees
        Degrees of freedom, > 0, not necessarily whole.
    """
    shape, half = degrees / 2, np.maximum(value, 0.0) / 2
    tail = gammaincc(shape, half)
    far = tail < LEAST_TAIL
    large = np.where(far, half, 1.0)
    # Abramowitz and Stegun (1964), 6.5.32.
    series = 1 + (shape - 1) / large * (1 + (shape - 2) / large)
    expansion = (shape - 1) * np.log(large) - large - gammaln(shape) + np.log(np.abs(series))
    return np.asarray(np.where(far, expansion, np.log(np.where(far, 1.0, tail))))


def log_weighted_tail(value: Array, weights: Array) -> Array:
    """The log probability that ``sum_i weights_i x_i^2``, x standard normal, exceeds `value`.

    A chi-square variable is shifted and scaled to the first three moments; exact where the weights
    are equal.

    Parameters
    ----------
    value
        Any shape.
    weights
        Not negative, at least one positive, shape ``(k,)``.

    References
    ----------
    J. P. Imhof, Computing the distribution of quadratic forms in normal variables, Biometrika 48
    (1961) 419-426, section 4, doi:10.1093/biomet/48.3-4.419.
    """
    mean, squares, cubes = (float(np.sum(weights**power)) for power in (1, 2, 3))
    degrees = squares**3 / cubes**2
    return log_chi2_tail((value - mean) * squares / cubes + degrees, degrees)


def z_score_of_log_tail(log_tail: Array) -> Array:
    """The z-score that is exceeded with the same probability."""
    return np.asarray(-ndtri_exp(np.minimum(log_tail, 0.0)))


def log_tail_of_z_score(z_score: Array) -> Array:
    """The log probability that a standard normal variable exceeds `z_score`."""
    return np.asarray(log_ndtr(-z_score))


LEVEL = 0.05
N_DRAWS = 4000
UNLOADED = "no load"
# Share of the length of a shift: if less is left, the fitted parameters explain the shift.
LEAST_LEFT = 1e-6


@declared
class TrialLayout:
    """The layout of the trials on the map of misfit.

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
        """The location of the misfit, as a sentence."""
        if not self.region:
            return "No region stands out."
        return (
            f"{self.region[0].coordinate} {places_words(self.region)}, "
            f"{100 * self.share:.0f} % of the excess"
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
    # The cells that have data: coordinate, flexion, direction, and which of the m values it holds.
    whole: list[tuple[str, float, str, BoolArray]] = []
    for index, coordinate in enumerate(layout.coordinates):
        for flexion in np.unique(layout.flexion_deg).tolist():
            for direction, trials in layout.sides().items():
                where = np.zeros(layout.is_measured.shape, dtype=bool)
                where[:, index] = trials & (layout.flexion_deg == flexion)
                rows = where[layout.is_measured]
                if rows.any():
                    whole.append((coordinate, flexion, direction, rows))
    # Those whose shift the parameters do not explain, and these shifts as columns of length 1.
    shifts = noise.whiten(np.stack([x[3] for x in whole], axis=1).astype(np.float64))
    columns = projector.project(shifts)
    size = np.linalg.norm(columns, axis=0)
    seen = size > LEAST_LEFT * np.linalg.norm(shifts, axis=0)
    cells = [cell for cell, is_seen in zip(whole, seen, strict=True) if is_seen]
    columns = columns[:, seen] / size[seen]
    scores = projector.project(residuals) @ columns
    # Probability that noise makes the largest score of any cell as large.
    _, values, vectors = np.linalg.svd(columns, full_matrices=False)
    draws = np.random.default_rng(seed).standard_normal((N_DRAWS, len(values)))
    largest = np.sort(np.abs(draws @ (values[:, None] * vectors)).max(axis=1))
    above = N_DRAWS - np.searchsorted(largest, np.abs(scores))
    p_values = np.asarray((above + 1) / (N_DRAWS + 1))
    found = tuple(
        CellScore(
            coordinate=coordinate,
            flexion_deg=flexion,
            direction=direction,
            score=float(score),
            p_value=float(p_value),
        )
        for (coordinate, flexion, direction, _), score, p_value in zip(
            cells, scores, p_values, strict=True
        )
    )
    region = _region(found, layout)
    rows = np.zeros(noise.n, dtype=bool)
    for index in region:
        rows |= cells[index][3]
    share = _fraction_of_excess(residuals, projector, noise, rows) if region else 0.0
    return Localisation(cells=found, region=tuple(found[i] for i in region), share=share)


def _region(cells: Sequence[CellScore], layout: TrialLayout) -> list[int]:
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


def _fraction_of_excess(
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


def places_words(region: Sequence[CellScore]) -> str:
    """Directions of load with their angles, those with the same angles in one phrase."""
    angles = {
        direction: tuple(x.flexion_deg for x in region if x.direction == direction)
        for direction in dict.fromkeys(x.direction for x in region)
    }
    places = []
    for shared in dict.fromkeys(angles.values()):
        directions = listed(x for x, own in angles.items() if own == shared)
        places.append(f"under {directions} at {listed(f'{x:g}' for x in shared)} deg")
    return "; ".join(places)
