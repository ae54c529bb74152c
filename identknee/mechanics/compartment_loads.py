"""Contact force of each tibial surface and the centre of that force, with their derivatives."""

import math

import numpy as np

from identknee.mechanics.contact_points import ContactPlaces, contact_places, distance_bending
from identknee.mechanics.distance_field import ContactLaw, DistanceField
from identknee.mechanics.equilibria import ContactPoints
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry


@declared
class CompartmentLoads:
    """Contact of c tibial surfaces in n poses: the k points that touch, and the loads.

    The force of a surface is the sum of the forces of its points, each along its own normal; the
    centre is the mean of their places, weighted by force.
    """

    touching: ContactPlaces = entry("The points that touch")
    n_poses: int = entry("How many poses there are", unit="1")
    n_surfaces: int = entry("How many tibial surfaces", unit="1")
    surface: IntArray = entry("Which surface each point belongs to, shape ``(k,)``")
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
        """Force [N] and centre [mm] of each surface, ``(n, c, 4)``; NaN for a centre of none."""
        total = self._summed(self.force)
        with np.errstate(invalid="ignore"):
            centres = self._summed(self.force[:, None] * self.places) / total[..., None]
        return np.concatenate([total[..., None], centres], axis=2)

    def derivatives(self, motion: Array, strengthening: Array | float = 0.0) -> Array:
        """Derivatives of `values` by a numbers, shape ``(n, c, 4, a)``.

        Parameters
        ----------
        motion
            Those of the places of the points in the axes of the femur's distance, ``(k, 3, a)``.
        strengthening
            Those of the forces where no point moves, shape ``(k, a)``.
        """
        changes = np.einsum("ki,kia->ka", self.by_motion, motion) + strengthening
        values = self.values
        away = self.places - values[self.touching.pose, self.surface, 1:]
        moments = self._summed(away[:, :, None] * changes[:, None])
        with np.errstate(invalid="ignore"):
            centres = moments / values[..., :1, None]
        return np.concatenate([self._summed(changes)[:, :, None], centres], axis=2)

    def force_under(self, law: ContactLaw) -> Array:
        """Force of each point under another contact law, as deep as it is [N], shape ``(k,)``."""
        size = np.linalg.norm(self.touching.outward, axis=1)
        return np.asarray(self.areas * law.pressure(self.touching.depth)[0] * size)

    @property
    def by_pose(self) -> Array:
        """Derivatives of `values` by the pose [N/rad, N/mm, mm/rad, -], ``(n, c, 4, 5)``."""
        return self.derivatives(np.swapaxes(self.touching.jacobian, 1, 2))

    def _summed(self, of_points: Array) -> Array:
        """Sums over the points of each surface in each pose, ``(n, c, ...)`` of ``(k, ...)``."""
        # It loads most of scipy.
        from scipy.sparse import csr_array

        k, n = len(of_points), self.n_poses * self.n_surfaces
        owner = self.touching.pose * self.n_surfaces + self.surface
        is_of = csr_array((np.ones(k), (owner, np.arange(k))), shape=(n, k))
        flat = is_of @ of_points.reshape(k, math.prod(of_points.shape[1:]))
        return np.asarray(flat).reshape(self.n_poses, self.n_surfaces, *of_points.shape[1:])


def compartment_loads(
    contact: ContactPoints, field: DistanceField, flexion: Array, poses: Array, places: Array
) -> CompartmentLoads:
    """The contact of each tibial surface at flexion angles ``(n,)`` [rad] and poses ``(n, 5)``.

    Parameters
    ----------
    contact, field
        The surfaces, for poses between measured frames.
    places
        Where the contact points are in the axes in which the centre is wanted [mm], ``(m, 3)``.
    """
    touching = contact_places(contact, field, flexion, poses)
    outward, own = touching.outward, touching.index
    # A point pushes along the slope of the distance, whose size a spline keeps only nearly at 1.
    size = np.linalg.norm(outward, axis=1)
    bending = np.einsum("kij,kj->ki", distance_bending(field, touching.femoral), outward)
    return CompartmentLoads(
        touching=touching,
        n_poses=len(poses),
        n_surfaces=contact.n_compartments,
        surface=contact.compartment[own],
        places=places[own],
        areas=contact.areas[own],
        force=touching.force * size,
        by_motion=(touching.force / size)[:, None] * bending
        - (touching.stiffness * size)[:, None] * outward,
    )
