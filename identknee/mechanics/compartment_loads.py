"""Contact force of each tibial surface and the centre of that force, with their derivatives."""

import numpy as np

from identknee.mechanics.contact_points import ContactPlaces, contact_places, distance_bending
from identknee.mechanics.distance_field import ContactLaw, DistanceField
from identknee.mechanics.equilibria import ContactPoints
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry


@declared
class CompartmentLoads:
    """Contact of the c tibial surfaces in one pose: the k points that touch, and their loads.

    The force of a surface is the sum of the forces of its points, each along its own normal; the
    centre is the mean of their places, weighted by force.
    """

    touching: ContactPlaces = entry("The points that touch")
    is_of: BoolArray = entry("Which point belongs to which surface, shape ``(c, k)``")
    places: Array = array("Where the points are on the tibia", "point", "axis", unit="mm")
    areas: Array = array("Their tributary areas", "point", unit="mm2")
    force: Array = array("Force of each", "point", unit="N")
    by_motion: Array = array(
        "Its derivative by the place of the point in the axes of the femur's distance",
        *("point", "axis"),
        unit="N/mm",
    )

    @property
    def values(self) -> Array:
        """Force [N] and its centre [mm] of each surface, ``(c, 4)``; NaN for a centre of none."""
        total = self.is_of @ self.force
        with np.errstate(invalid="ignore"):
            centres = self.is_of @ (self.force[:, None] * self.places) / total[:, None]
        return np.column_stack([total, centres])

    def derivatives(self, motion: Array, strengthening: Array | float = 0.0) -> Array:
        """Derivatives of `values` by a numbers, shape ``(c, 4, a)``.

        Parameters
        ----------
        motion
            Those of the places of the points in the axes of the femur's distance, ``(k, 3, a)``.
        strengthening
            Those of the forces where no point moves, shape ``(k, a)``.
        """
        changes = np.einsum("ki,kia->ka", self.by_motion, motion) + strengthening
        values = self.values
        moments = np.stack(
            [
                own @ ((self.places - centre)[:, :, None] * changes[:, None]).transpose(1, 0, 2)
                for own, centre in zip(self.is_of.astype(float), values[:, 1:], strict=True)
            ]
        )
        with np.errstate(invalid="ignore"):
            centres = moments / values[:, :1, None]
        return np.concatenate([(self.is_of @ changes)[:, None], centres], axis=1)

    def force_under(self, law: ContactLaw) -> Array:
        """Force of each point under another contact law, as deep as it is [N], shape ``(k,)``."""
        size = np.linalg.norm(self.touching.outward, axis=1)
        return np.asarray(self.areas * law.pressure(self.touching.depth)[0] * size)

    @property
    def by_pose(self) -> Array:
        """Derivatives of `values` by the pose [N/rad, N/mm, mm/rad, -], shape ``(c, 4, 5)``."""
        return self.derivatives(np.swapaxes(self.touching.jacobian, 1, 2))


def compartment_loads(
    contact: ContactPoints, field: DistanceField, flexion: float, pose: Array, places: Array
) -> CompartmentLoads:
    """The contact of each tibial surface at `flexion` [rad] and a pose (5,).

    Parameters
    ----------
    contact, field
        The surfaces, for poses between measured frames.
    places
        Where the contact points are in the axes in which the centre is wanted [mm], ``(n, 3)``.
    """
    touching = contact_places(contact, field, flexion, pose)
    outward, own = touching.outward, touching.index
    # A point pushes along the slope of the distance, whose size a spline keeps only nearly at 1.
    size = np.linalg.norm(outward, axis=1)
    bending = np.einsum("kij,kj->ki", distance_bending(field, touching.femoral), outward)
    return CompartmentLoads(
        touching=touching,
        is_of=contact.compartment[own] == np.arange(contact.n_compartments)[:, None],
        places=places[own],
        areas=contact.areas[own],
        force=touching.force * size,
        by_motion=(touching.force / size)[:, None] * bending
        - (touching.stiffness * size)[:, None] * outward,
    )
