"""A tibial plateau as a height field over a super-ellipse, and its mesh."""

from dataclasses import dataclass

import numpy as np

from identknee.runs.arrays import Array, IntArray
from identknee.subject.surface import Surface


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau:
    """A tilted, curved plateau with its side of the eminence.

    Attributes
    ----------
    centre_x, centre_z, height
        Its centre [mm].
    slope, tilt
        Posterior slope and coronal tilt [deg].
    curvature_x, curvature_z
        Sagittal and coronal curvature [1/mm], positive where concave.
    eminence_height, eminence_x, eminence_z, eminence_width_x, eminence_width_z
        Height, top and widths of the Gaussian eminence [mm].
    half_length, half_width, exponent
        Outline ``|dx/half_length|^exponent + |dz/half_width|^exponent = 1`` [mm].
    """

    centre_x: float
    centre_z: float
    height: float
    slope: float
    tilt: float
    curvature_x: float
    curvature_z: float
    eminence_height: float
    eminence_x: float
    eminence_z: float
    eminence_width_x: float
    eminence_width_z: float
    half_length: float
    half_width: float
    exponent: float

    def heights(self, x: Array, z: Array) -> Array:
        """Height y of the plateau [mm] at positions `x` and `z` [mm]."""
        dx, dz = x - self.centre_x, z - self.centre_z
        plane = np.tan(np.radians(self.slope)) * dx + np.tan(np.radians(self.tilt)) * dz
        bowl = 0.5 * (self.curvature_x * dx**2 + self.curvature_z * dz**2)
        from_top = ((x - self.eminence_x) / self.eminence_width_x) ** 2
        from_top = from_top + ((z - self.eminence_z) / self.eminence_width_z) ** 2
        heights: Array = self.height + plane + bowl + self.eminence_height * np.exp(-0.5 * from_top)
        return heights

    def mesh(self, edge: float) -> Surface:
        """Triangles with edges of about `edge` [mm], its normals pointing up.

        Ring k of the outline holds 6 k vertices; the rings are circles in the middle and take the
        shape of the outline towards the rim.
        """
        rings = int(np.ceil(max(self.half_length, self.half_width) / edge))
        ring = np.repeat(np.arange(1, rings + 1), 6 * np.arange(1, rings + 1))
        place = np.arange(len(ring)) - 3 * ring * (ring - 1)
        angle = 2.0 * np.pi * place / (6 * ring)
        share = ring / rings
        power = 2.0 + (self.exponent - 2.0) * share
        along, across = np.cos(angle), np.sin(angle)
        radius = share * (np.abs(along) ** power + np.abs(across) ** power) ** (-1.0 / power)
        x = self.centre_x + self.half_length * np.r_[0.0, radius * along]
        z = self.centre_z + self.half_width * np.r_[0.0, radius * across]
        return Surface(vertices=np.c_[x, self.heights(x, z), z], faces=_ring_faces(rings))


def _ring_faces(rings: int) -> IntArray:
    """Triangles of concentric rings of 6 k vertices, numbered from the centre; ``(6 rings^2, 3)``.

    Each of the six sectors between ring k-1 and ring k is a strip of 2 k - 1 triangles.
    """
    faces = []
    for k in range(1, rings + 1):
        outer_start, inner_start = 1 + 3 * k * (k - 1), 1 + 3 * (k - 1) * (k - 2)
        inner_number = max(6 * (k - 1), 1)
        sector, step = (x.ravel() for x in np.meshgrid(np.arange(6), np.arange(k), indexing="ij"))
        outer = outer_start + k * sector + step
        following = outer_start + (k * sector + step + 1) % (6 * k)
        inner = (inner_start if k > 1 else 0) + ((k - 1) * sector + step) % inner_number
        faces.append(np.c_[inner, following, outer])
        if k > 1:
            between = step < k - 1
            beside = inner_start + ((k - 1) * sector + step + 1) % inner_number
            faces.append(np.c_[inner, beside, following][between])
    return np.concatenate(faces)
