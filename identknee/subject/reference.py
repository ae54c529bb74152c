"""The reference knee: an analytic subject made of closed formulas, meshed at any edge length."""

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identknee.runs.declare import Array, IntArray
from identknee.subject.examples import REFERENCE
from identknee.subject.knee import Frame, Knee
from identknee.subject.ligament import Ligament
from identknee.subject.surface import Surface, joined

ComplexArray = NDArray[np.complex128]
# Nodes of the spine among which the nearest is sought first, and the Newton steps from there. Half
# a spacing is 0.4 deg, from where three steps reach rounding near the surface.
NODES = 241
NEWTON_STEPS = 3
# Points handled at once, so that the table of their distances to the nodes stays in the cache.
BLOCK = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class Condyle:
    """A canal surface: spheres of one radius whose centres run along a spine.

    The angle psi of the surface normal parametrises it: 0 where the normal points down, pi/2 where
    it points backwards. In the sagittal plane the radius of curvature changes smoothly from the
    distal to the posterior radius over ``transition_centre +- transition_half_width``.

    Attributes
    ----------
    distal_radius, posterior_radius
        Sagittal radii of curvature [mm].
    transition_centre, transition_half_width
        Where the radius changes [deg].
    tube_radius
        Radius of the spheres [mm], less than the posterior radius.
    spine_x, spine_y
        Position of the spine at 90 deg [mm].
    spine_z, divergence
        The spine's z is ``spine_z + divergence sin(psi)`` [mm].
    first_angle, last_angle
        Ends of the spine [deg]; spherical caps close the surface beyond.
    half_aperture
        Half the coronal extent of the mesh [deg].
    """

    distal_radius: float
    posterior_radius: float
    transition_centre: float
    transition_half_width: float
    tube_radius: float
    spine_x: float
    spine_y: float
    spine_z: float
    divergence: float
    first_angle: float
    last_angle: float
    half_aperture: float

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the spine [rad]."""
        return float(np.radians(self.first_angle)), float(np.radians(self.last_angle))

    def spine(self, psi: Array) -> tuple[Array, Array, Array]:
        """Centres of the spheres at `psi` [rad] and their first and second derivative by it.

        Shape ``(3, ...)`` each [mm]. In the sagittal plane the derivative is the spine's radius of
        curvature ``rho(psi)`` times a unit vector, so that the spine is the integral of
        ``rho exp(i psi)``, whose real and imaginary part are its two coordinates.
        """
        turning = np.exp(1j * psi)
        start, rate, mean, swing = self._transition
        end = start + np.pi / rate
        phase = rate * (np.clip(psi, start, end) - start)
        wave, quarter = np.cos(phase), np.sin(phase)
        rho, change = mean + swing * wave, -swing * rate * quarter
        swept = self._swept(psi, turning, wave - 1j * rate * quarter) - self._swept_to_rear
        cos, sin = turning.real, turning.imag
        flat = self.divergence
        return (
            np.array(
                [self.spine_x - swept.real, self.spine_y + swept.imag, self.spine_z + flat * sin]
            ),
            np.array([-rho * cos, rho * sin, flat * cos]),
            np.array([rho * sin - change * cos, rho * cos + change * sin, -flat * sin]),
        )

    def surface_points(self, psi: Array, phi: Array) -> Array:
        """Points of the surface [mm] at `psi` and at the coronal angle `phi` [rad], ``(n, 3)``."""
        centre, tangent, _ = self.spine(psi)
        down = np.array([-np.sin(psi), -np.cos(psi), np.zeros_like(psi)])
        across = np.cross(down, tangent, axis=0)
        across *= np.sign(across[2]) / np.linalg.norm(across, axis=0)
        normal = np.cos(phi) * down + np.sin(phi) * across
        return np.asarray((centre + self.tube_radius * normal).T)

    def mesh(self, edge: float) -> Surface:
        """Triangles with edges of about `edge` [mm], its normals pointing out of the condyle."""
        fine = np.linspace(*self.limits, 1000)
        ridge = self.surface_points(fine, np.zeros_like(fine))
        arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(ridge, axis=0), axis=1))]
        rows = max(4, int(np.ceil(arc[-1] / edge))) + 1
        aperture = np.radians(self.half_aperture)
        columns = max(4, int(np.ceil(2.0 * aperture * self.tube_radius / edge))) + 1
        psi, phi = np.meshgrid(
            np.interp(np.linspace(0.0, arc[-1], rows), arc, fine),
            np.linspace(-aperture, aperture, columns),
            indexing="ij",
        )
        number = np.arange(rows * columns).reshape(rows, columns)
        corner, along, both, side = (
            x.ravel() for x in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
        )
        faces = np.r_[np.c_[corner, side, both], np.c_[corner, both, along]]
        return Surface(vertices=self.surface_points(psi.ravel(), phi.ravel()), faces=faces)

    def distance(self, points: Array) -> Array:
        """Signed distance of `points` (n, 3) to the surface [mm], negative inside; ``(n,)``.

        The nearest of many nodes of the spine brackets the nearest place, safeguarded Newton steps
        find it.
        """
        psi = np.linspace(*self.limits, NODES)
        nodes = self.spine(psi)[0]
        half_squares = 0.5 * (nodes**2).sum(axis=0)
        result = np.empty(len(points))
        for start in range(0, len(points), BLOCK):
            block = points[start : start + BLOCK]
            nearest = psi[np.argmin(half_squares - block @ nodes, axis=1)]
            result[start : start + BLOCK] = self._refined(block.T, nearest, psi[1] - psi[0])
        return result - self.tube_radius

    def _refined(self, points: Array, nearest: Array, spacing: float) -> Array:
        """Distance of `points` (3, n) to the spine [mm], the angle of the nearest node known."""
        low = np.maximum(nearest - spacing, self.limits[0])
        high = np.minimum(nearest + spacing, self.limits[1])
        angle = nearest
        least = np.full(len(nearest), np.inf)
        for step in range(NEWTON_STEPS + 1):
            centre, first, second = self.spine(angle)
            gap = centre - points
            np.minimum(least, np.einsum("in,in->n", gap, gap), out=least)
            if step == NEWTON_STEPS:
                break
            square = np.einsum("in,in->n", first, first)
            curvature = square + np.einsum("in,in->n", gap, second)
            # Where the distance is not convex, a step as if the spine were straight still descends.
            curvature = np.where(curvature > 0.0, curvature, square)
            newton = angle - np.einsum("in,in->n", gap, first) / curvature
            angle = np.clip(newton, low, high)
        return np.asarray(np.sqrt(least))

    @property
    def _transition(self) -> tuple[float, float, float, float]:
        """Start [rad], rate, mean and swing [mm] of ``rho = mean + swing cos(rate (psi - start))``.

        rho is the spine's own radius of curvature in the sagittal plane, constant before and after.
        """
        start = np.radians(self.transition_centre - self.transition_half_width)
        rate = np.pi / np.radians(2.0 * self.transition_half_width)
        mean = 0.5 * (self.distal_radius + self.posterior_radius) - self.tube_radius
        swing = 0.5 * (self.distal_radius - self.posterior_radius)
        return float(start), float(rate), mean, swing

    @property
    def _swept_to_rear(self) -> complex:
        """The antiderivative at 90 deg, beyond the transition or not."""
        psi = np.array([np.pi / 2.0])
        start, rate, _, _ = self._transition
        phase = rate * (np.clip(psi, start, start + np.pi / rate) - start)
        factor = np.cos(phase) - 1j * rate * np.sin(phase)
        return complex(self._swept(psi, np.exp(1j * psi), factor)[0])

    def _swept(self, psi: Array, turning: ComplexArray, factor: ComplexArray) -> ComplexArray:
        """Continuous antiderivative of ``rho exp(i psi)``; `turning` is ``exp(i psi)``.

        Within the transition the integral of ``cos(rate v) exp(i psi)``, v from its start, is
        ``-i exp(i psi) factor / (1 - rate^2)`` with ``factor = cos(rate v) - i rate sin(rate v)``.
        """
        start, rate, mean, swing = self._transition
        end = start + np.pi / rate
        at_start, at_end = np.exp(1j * start), np.exp(1j * end)
        before, after = psi < start, psi > end
        within = np.where(before, at_start, np.where(after, at_end, turning))
        total = mean * within + swing / (1.0 - rate**2) * within * factor
        total += np.where(before, (mean + swing) * (turning - at_start), 0.0)
        total += np.where(after, (mean - swing) * (turning - at_end), 0.0)
        return np.asarray(-1j * total)


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
        return np.asarray(
            self.height + plane + bowl + self.eminence_height * np.exp(-0.5 * from_top)
        )

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


EDGE_MM = 1.2
FINEST_FEMUR_EDGE_MM = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class CondyleDistance:
    """Signed distance to a femur that consists of condyles; call it with points ``(n, 3)`` [mm].

    Attributes
    ----------
    condyles
        Each of them.
    """

    condyles: tuple[Condyle, ...]

    def __call__(self, points: Array) -> Array:
        """Signed distance of each point [mm], negative inside, shape ``(n,)``."""
        return np.asarray(np.min([x.distance(points) for x in self.condyles], axis=0))


def reference_knee(edge_mm: float = EDGE_MM, *, femur_edge_mm: float | None = None) -> Knee:
    """The reference knee, a right knee whose two frames coincide in extension.

    Its surfaces are closed formulas fitted to real cartilage, its insertions are calibrated to
    published laxity, and its ligament parameters are the reference values of the initial-guess
    paper. It is a plausible default, not a measured subject.

    Parameters
    ----------
    edge_mm
        Typical edge of the tibial triangles [mm]; 1.2 gives 1,550 vertices.
    femur_edge_mm
        The same for the femur; the smaller of `edge_mm` and 0.8 if not given.

    Raises
    ------
    ValueError
        If an edge is not within 0.2 to 10 mm.

    Examples
    --------
    >>> knee = reference_knee()
    >>> sum(len(x.vertices) for x in knee.tibia)
    1550
    """
    if femur_edge_mm is None:
        femur_edge_mm = min(edge_mm, FINEST_FEMUR_EDGE_MM)
    for edge in (edge_mm, femur_edge_mm):
        if not 0.2 <= edge <= 10.0:
            raise ValueError(f"the edge of the triangles must be within 0.2 to 10 mm, got {edge:g}")
    return _reference_knee(float(edge_mm), float(femur_edge_mm))


# A knee cannot change, and whatever is worked out of its surfaces is kept with it.
@lru_cache(maxsize=4)
def _reference_knee(edge_mm: float, femur_edge_mm: float) -> Knee:
    table = resources.files("identknee.subject").joinpath("reference_knee.toml")
    numbers = tomllib.loads(table.read_text("utf-8"))
    condyles = tuple(Condyle(**_values(x)) for x in numbers["femur"].values())
    plateaus = [Plateau(**_values(numbers["tibia"][side])) for side in ("medial", "lateral")]
    frame = Frame(origin=np.zeros(3), axes=np.eye(3))
    return Knee(
        name=REFERENCE,
        side="right",
        description="Analytic reference knee: canal-surface condyles, height-field plateaus.",
        femur=joined(*(x.mesh(femur_edge_mm) for x in condyles)),
        tibia=tuple(x.mesh(edge_mm) for x in plateaus),
        ligaments=tuple(
            Ligament(
                name=name,
                femur=entry["femur"]["value"],
                tibia=entry["tibia"]["value"],
                stiffness_kN=entry["stiffness"]["value"],
                reference_strain_pct=entry["reference_strain"]["value"],
            )
            for name, entry in numbers["ligaments"].items()
        ),
        femur_frame=frame,
        tibia_frame=frame,
        femur_distance=CondyleDistance(condyles=condyles),
    )


def _values(table: dict[str, Any]) -> dict[str, float]:
    """Values of a table whose entries also state unit and source."""
    return {name: entry["value"] for name, entry in table.items()}
