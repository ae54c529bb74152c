"""Points of a region far from one another, found along rays and chosen farthest first."""

import numpy as np

from identknee.identify.equivalents.region import Blocks, RegionView
from identknee.runs.arrays import Array, IntArray

# A point this close to the limit is on the boundary of the region, for a ray.
BOUNDARY = 0.9
TARGET = 0.97
MOST_TRIALS = 6
# Share of the box beyond which no semi-axis of the linear model reaches.
BOX_PART = 0.5


def longest_axes(view: RegionView, theta: Array) -> Array:
    """Semi-axes of the ellipsoid that the region's linear model makes at a point, ``(n, n)``.

    They come from the longest to the shortest. Along directions that the predictions do not depend
    on they reach as far as the box. Where there are several blocks the ellipsoid is that of their
    sum.
    """
    steps = view.steps
    slopes = view(theta).slopes * steps
    _, size, right = np.linalg.svd(slopes.reshape(-1, steps.size), full_matrices=False)
    widest = BOX_PART * float(np.max((view.upper - view.lower) / steps))
    return np.asarray(steps * right / np.hypot(size, 1.0 / widest)[:, None])[::-1]


def points_along(view: RegionView, origin: Array, direction: Array, share: float) -> list[Array]:
    """The last point inside on a ray and one between it and the origin, simulated; or fewer.

    Parameters
    ----------
    view
        The region.
    origin
        A point inside, shape ``(n,)``.
    direction
        The ray, shape ``(n,)``, of any length; turned back where it leads out at once.
    share
        Where the point between stands: 0 at the origin, 1 at the other.
    """
    blocks = view(origin)
    uphill = np.einsum("bki,bk->bi", blocks.slopes, blocks.offsets)[np.argmax(blocks.values)]
    if blocks.largest > BOUNDARY and uphill @ direction > 0:
        direction = -direction
    reach = _reach(blocks, direction)
    longest = _to_bounds(view, origin, direction)
    low, high = 0.0, np.inf
    last: Array | None = None
    for _ in range(MOST_TRIALS):
        length = min(low + reach, longest)
        if length >= high:
            length = 0.5 * (low + high)
        theta = np.clip(origin + length * direction, view.lower, view.upper)
        blocks = view(theta)
        if blocks.largest > 1.0:
            high = length
            reach = 0.5 * (high - low)
            continue
        low, last = length, theta
        if blocks.largest > BOUNDARY or length == longest:
            break
        reach = _reach(blocks, direction)
    if last is None:
        return []
    between = origin + share * (last - origin)
    return [last, between] if view(between).largest <= 1.0 else [last]


def farthest_first(points: Array, first: IntArray, n: int, least: float) -> IntArray:
    """Which of the points to take so that each is as far from those before it as can be.

    Parameters
    ----------
    points
        Shape ``(n_points, p)``, in units in which distance is Euclidean.
    first
        Those to begin with.
    n
        How many to take.
    least
        The least distance between two; there may be fewer than `n` then.

    References
    ----------
    T. F. Gonzalez, Clustering to minimize the maximum intercluster distance, Theoretical Computer
    Science 38 (1985) 293-306, doi:10.1016/0304-3975(85)90224-5: no choice of as many of these
    points has a smallest distance more than twice as large.

    Examples
    --------
    >>> line = np.array([[0.0], [0.9], [0.5], [1.0]])
    >>> farthest_first(line, np.array([0, 3]), 3, 0.2)
    array([0, 3, 2])
    """
    chosen = [int(i) for i in first]
    distance = np.min([np.linalg.norm(points - points[i], axis=1) for i in chosen], axis=0)
    while len(chosen) < n:
        next_one = int(np.argmax(distance))
        if distance[next_one] < least:
            break
        chosen.append(next_one)
        apart = np.linalg.norm(points - points[next_one], axis=1)
        distance = np.minimum(distance, apart)
    return np.array(chosen, dtype=np.int64)


def _reach(blocks: Blocks, direction: Array) -> float:
    """How far along the direction the linear model stays just inside; inf if for ever."""
    slope = blocks.slopes @ direction
    square = np.einsum("bk,bk->b", slope, slope)
    half = np.einsum("bk,bk->b", slope, blocks.offsets)
    room = np.maximum(TARGET - blocks.values, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = (np.sqrt(half**2 + square * room) - half) / square
    return float(np.min(np.where(square > 0, roots, np.inf)))


def _to_bounds(view: RegionView, origin: Array, direction: Array) -> float:
    """How far along the direction the bounds are."""
    wall = np.where(direction > 0, view.upper, view.lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        lengths = (wall - origin) / direction
    return float(np.min(np.where(direction == 0.0, np.inf, lengths)))
