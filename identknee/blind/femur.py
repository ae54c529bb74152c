"""Signed distance to the femur on a grid: from its closed form, or from vertices and normals."""

import hashlib
import os
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import cache_folder, prepare_folder
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface

SPACING_MM = 0.9
# Distances are cut off here, and the grid reaches this far beyond the surface [mm].
BAND_MM = 5.0
# Vertices that share in the distance to a place, and the width of their weights over the edge.
NEIGHBOURS = 24
WIDTH = 0.8
BLOCK = 20000
FORMAT = 2


@declared
class DistanceGrid:
    """Signed distance to the femoral surface at the nodes of a grid in the femur's frame."""

    values: Array = entry(
        "Distance at the nodes [mm], negative inside, cut off at `BAND_MM`, shape ``(a, b, c)``"
    )
    origin: Array = entry("Position of the first node [mm], shape ``(3,)``")
    spacing: float = entry("Distance between nodes [mm]")


def distance_grid(knee: Knee) -> DistanceGrid:
    """The grid of a knee's femur, kept on disk between calls under a digest of the surface.

    The closed form is used where the knee has one. Otherwise the distance at a place is the
    average of its distances to the tangent planes of the vertices around, with Gaussian weights
    (an implicit moving least squares surface), which rounds the facets off. Beyond the rim of an
    open surface it is the plain distance, so that nothing is inside there.

    References
    ----------
    .. [1] Kolluri (2008), ACM Trans. Algorithms 4(2), 18. https://doi.org/10.1145/1361192.1361195
    """
    local = Surface(vertices=knee.femur_frame.to_local(knee.femur.vertices), faces=knee.femur.faces)
    origin = local.vertices.min(axis=0) - BAND_MM - 2.0 * SPACING_MM
    counts = np.ceil((local.vertices.max(axis=0) + BAND_MM - origin) / SPACING_MM) + 2.0
    name = hashlib.sha256(f"{FORMAT} {SPACING_MM} {BAND_MM} {NEIGHBOURS} {WIDTH}".encode())
    name.update(local.vertices.tobytes() + local.faces.tobytes())
    name.update(repr(knee.femur_distance).encode() if knee.femur_distance is not None else b"")
    path = cache_folder() / "blind" / f"femur-{name.hexdigest()[:24]}.npy"
    values = _kept(path)
    if values is None:
        nodes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
        places = origin + SPACING_MM * nodes.reshape(-1, 3)
        if knee.femur_distance is None:
            distance = _from_vertices(local, places)
        else:
            distance = knee.femur_distance(knee.femur_frame.to_common(places))
        values = np.clip(distance, -BAND_MM, BAND_MM).reshape(nodes.shape[:3])
        _keep(path, values)
    return DistanceGrid(values=values, origin=origin, spacing=SPACING_MM)


def vertex_normals(surface: Surface) -> Array:
    """Unit outward normal of each vertex, shape ``(n, 3)``: of the triangles around, by area."""
    weighted = surface.normals * surface.areas[:, None]
    total = np.zeros_like(surface.vertices)
    for corner in range(3):
        np.add.at(total, surface.faces[:, corner], weighted)
    length = np.linalg.norm(total, axis=1)
    return np.asarray(total / np.where(length > 0.0, length, 1.0)[:, None])


def _from_vertices(surface: Surface, places: Array) -> Array:
    normals = vertex_normals(surface)
    corners = surface.vertices[surface.faces]
    edge = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    is_rim = np.zeros(len(normals), bool)
    is_rim[surface.boundary_edges.ravel()] = True
    tree = cKDTree(surface.vertices)
    nearest, number = tree.query(places)
    offset = places - surface.vertices[number]
    height = (offset * normals[number]).sum(axis=1)
    aside = np.linalg.norm(offset - height[:, None] * normals[number], axis=1)
    is_beyond = is_rim[number] & (aside > edge)
    result: Array = np.where(is_beyond, nearest, np.sign(height) * nearest)
    close = np.flatnonzero((nearest < BAND_MM) & ~is_beyond)
    for start in range(0, len(close), BLOCK):
        block = close[start : start + BLOCK]
        distance, around = tree.query(places[block], k=min(NEIGHBOURS, len(normals)))
        result[block] = _averaged(surface, normals, places[block], (distance, around), edge)
    return result


def _averaged(
    surface: Surface, normals: Array, places: Array, found: tuple[Array, IntArray], edge: float
) -> Array:
    """Distances to the tangent planes of the vertices found, averaged."""
    distance, around = found
    excess = distance**2 - distance[:, :1] ** 2
    weights = np.exp(-excess / (WIDTH * edge * (1.0 + distance[:, :1])) ** 2)
    heights = ((places[:, None] - surface.vertices[around]) * normals[around]).sum(axis=2)
    return np.asarray((weights * heights).sum(axis=1) / weights.sum(axis=1))


def _kept(path: Path) -> Array | None:
    try:
        values: Array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return values


def _keep(path: Path, values: Array) -> None:
    """Write the grid for the next call; without a place to write it is built again each time."""
    try:
        prepare_folder(path.parent)
    except InputError:
        return
    temporary = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        np.save(temporary, values)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
