"""Contact geometry of a knee: surfaces and ligaments as arrays in femoral and tibial axes."""

import hashlib
import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from zipfile import BadZipFile

import numpy as np

from identknee.mechanics.closest_point import mesh_distance
from identknee.mechanics.contact_points import (
    DEFAULT_NUMBER,
    RimDistance,
    contact_points,
    rim_distance,
)
from identknee.mechanics.distance_field import SPACING, ContactLaw, DistanceField, build_field
from identknee.mechanics.equilibria import ContactPoints, LineLigaments
from identknee.mechanics.pose import start_pose
from identknee.model.nuisances import contact_rounding
from identknee.runs.arrays import Array, IntArray, frozen
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import cache_folder, prepare_folder, write_atomically
from identknee.subject.knee import Knee

FIELD_FORMAT = b"field 6"
Sheet = tuple[Array, IntArray]


@declared
class ContactGeometry:
    """The arrays of a knee for the kernel."""

    field: DistanceField = entry("Signed distance to the femur, in femoral axes")
    contact: ContactPoints = entry("Points of the tibia that carry contact, in tibial axes")
    lines: LineLigaments = entry("The ligaments")
    femoral_rim: RimDistance = entry("How far places on the femoral surface are from its rim")
    tibial_rims: tuple[RimDistance, ...] = entry("The same of each tibial surface")
    start_flexion: float = entry("Flexion of the scanned pose [rad]")
    start: Array = entry("The scanned pose: varus, internal [rad], x, y, z [mm], shape ``(5,)``")


@lru_cache(maxsize=16)
def contact_geometry(knee: Knee, n_points: int | None = DEFAULT_NUMBER) -> ContactGeometry:
    """The joint of a knee with about `n_points` contact points (None for every vertex).

    The distance field is read from the cache on disk where it was built before.
    """
    (femoral, _), sheets = contact_sheets(knee)
    flexion, start = start_pose(
        knee.femur_frame.axes @ knee.tibia_frame.axes.T,
        knee.femur_frame.to_local(knee.tibia_frame.origin[None])[0],
    )
    insertions = np.array([x.femur for x in knee.ligaments]).reshape(-1, 3)
    tibial_insertions = np.array([x.tibia for x in knee.ligaments]).reshape(-1, 3)
    contact, rounding = contact_points(sheets, n_points), contact_rounding(knee)
    if rounding:
        contact = replace(contact, law=ContactLaw(rounding=rounding))
    return ContactGeometry(
        field=_field(knee, femoral),
        contact=contact,
        lines=LineLigaments(
            femoral=knee.femur_frame.to_local(insertions),
            tibial=knee.tibia_frame.to_local(tibial_insertions),
            reference_length=knee.reference_lengths,
        ),
        femoral_rim=rim_distance(femoral, knee.femur.faces),
        tibial_rims=tuple(rim_distance(vertices, faces) for vertices, faces in sheets),
        start_flexion=flexion,
        start=frozen(start, 5, name="start"),
    )


def contact_sheets(knee: Knee) -> tuple[Sheet, tuple[Sheet, ...]]:
    """Vertices and faces of the femur in femoral axes, of each tibial surface in tibial axes."""
    femur = (knee.femur_frame.to_local(knee.femur.vertices), knee.femur.faces)
    tibia = tuple((knee.tibia_frame.to_local(x.vertices), x.faces) for x in knee.tibia)
    return femur, tibia


def _field(knee: Knee, femoral: Array) -> DistanceField:
    """The distance field of the femur, from the cache or built and put there."""
    distance: Callable[[Array], Array] | None = None
    digest = hashlib.sha256(FIELD_FORMAT + repr(SPACING).encode())
    digest.update(femoral.tobytes())
    if knee.femur_distance is not None:
        closed_form = knee.femur_distance

        def distance(points: Array) -> Array:
            return closed_form(knee.femur_frame.to_common(points))

        # A formula has no bytes: what it gives off the surface stands for it.
        digest.update(distance(femoral[::7] * 1.02).tobytes())
    else:
        digest.update(knee.femur.faces.tobytes())
    path = cache_folder() / "fields" / f"{digest.hexdigest()[:24]}.npz"
    arrays = ("coefficients", "reach", "near", "origin", "spacing")
    # There is none, or it is damaged.
    missing = suppress(OSError, KeyError, ValueError, EOFError, BadZipFile)
    with missing, path.open("rb") as file, np.load(file) as kept:
        values = {x: kept[x] for x in arrays}
        return DistanceField(**{**values, "spacing": float(values["spacing"])})
    field = build_field(
        distance or mesh_distance(femoral, knee.femur.faces),
        femoral.min(axis=0),
        femoral.max(axis=0),
    )
    stored = io.BytesIO()
    np.savez(stored, **{x: getattr(field, x) for x in arrays})
    # A cache that cannot be written is no failure.
    with suppress(InputError):
        write_atomically(prepare_folder(path.parent) / path.name, stored.getvalue())
    return field
