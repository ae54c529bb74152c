"""One evaluation of the compiled energy as plain arrays, and what brute force says in its place."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from oracle import OracleKnee, State
from scipy.ndimage import map_coordinates

from identknee.mechanics.contact_elements import contact_element
from identknee.mechanics.distance_field import PRESSURE_MODULUS, DistanceField
from identknee.mechanics.energy import evaluate
from identknee.mechanics.equilibria import workspace
from identknee.mechanics.memory import N_LISTINGS, N_TOUCHING, POINT, record
from identknee.mechanics.pose import rotation_matrix
from identknee.model.laxity_model import ContactGeometry, LaxityModel
from identknee.runs.declare import Array

# Millimetres and newtons beside radians and newton millimetres.
SCALE = np.array([40.0, 40.0, 1.0, 1.0, 1.0])
NO_LOAD = np.zeros(5)


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Energy [N mm], gradient, Hessian, d gradient / d flexion; the points that carry force."""

    energy: float
    gradient: Array
    hessian: Array
    flexion_slope: Array
    touching: frozenset[int]

    @property
    def residual(self) -> float:
        """Size of the gradient [N], moments divided by 40 mm."""
        return float(np.linalg.norm(self.gradient / SCALE))


def point_at(pose: Array) -> Any:
    """A point of the kernel at this pose, nothing known of it yet."""
    point = record(POINT)
    point.pose = pose
    return point


class Evaluator:
    """The energy of a joint; its list of candidates lives on from one pose to the next."""

    def __init__(self, joint: ContactGeometry) -> None:
        self._contact, self._field = joint.contact.arrays(), joint.field.arrays()
        self.work = workspace(joint.contact.n_points).evaluation

    def __call__(
        self, flexion: float, pose: Array, ligaments: Any, load: Array = NO_LOAD
    ) -> Evaluation:
        at = point_at(pose)
        energy = evaluate(flexion, load, self._contact, self._field, ligaments, self.work, at)
        carries = np.linalg.norm(self.contact_forces(), axis=1) > 0.0
        return Evaluation(
            energy=float(energy),
            gradient=at.gradient,
            hessian=at.hessian,
            flexion_slope=at.gradient_by_flexion,
            touching=frozenset(self.work.touching[: len(carries)][carries].tolist()),
        )

    def contact_forces(self) -> Array:
        """Gradients of the energy by the place of each expanded contact point [N], ``(n, 3)``."""
        return np.array([first[3:] for first, *_ in self._contact_elements()]).reshape(-1, 3)

    def contact_depths(self) -> Array:
        """Depth of each, as the contact law feels it [mm], shape ``(n,)``."""
        return np.array([felt for _, _, _, felt, _ in self._contact_elements()])

    def _contact_elements(self) -> list[Any]:
        work, placed, law = self.work, self.work.placed, self._contact.law
        return [
            contact_element(work.expansion, i, placed.rotation, placed.translation, *law)
            for i in range(placed.counts[N_TOUCHING])
        ]

    @property
    def n_listings(self) -> int:
        """How often the list of candidates was made."""
        return int(self.work.placed.counts[N_LISTINGS])


def ligaments_of(model: LaxityModel, theta: Array) -> Any:
    """The ligaments at theta as the kernel takes them."""
    return model.joint.lines.arrays(*model._unpacked(theta))


def field_values(field: DistanceField, places: Array) -> Array:
    """The spline at `places` (n, 3) by scipy."""
    index = (places - field.origin) / field.spacing
    return np.asarray(
        map_coordinates(field.coefficients, index.T, order=3, prefilter=False, mode="mirror")
    )


def femoral_places(flexion: float, pose: Array, points: Array) -> Array:
    """Tibial points (n, 3) in femoral axes."""
    origin = rotation_matrix(flexion, 0.0, 0.0) @ pose[2:]
    return np.asarray(points @ rotation_matrix(flexion, pose[0], pose[1]).T + origin)


def depths(joint: ContactGeometry, flexion: float, pose: Array) -> Array:
    """Signed distance of every contact point to the femur [mm], without any list."""
    places = femoral_places(flexion, pose, joint.contact.points)
    size = np.array(joint.field.coefficients.shape)
    cell = np.floor((places - joint.field.origin) / joint.field.spacing)
    supported = ((cell >= 1) & (cell <= size - 3)).all(axis=1)
    return np.where(supported, field_values(joint.field, places), 1.0)


def contact_energy(joint: ContactGeometry, depth: Array) -> float:
    """Energy of springs compressed by the depths that are negative [N mm]."""
    inside = np.minimum(depth, 0.0)
    return float(0.5 * PRESSURE_MODULUS * (joint.contact.areas * inside**2).sum())


def oracle_of(joint: ContactGeometry) -> OracleKnee:
    """The joint for the oracle."""
    return OracleKnee(
        coefficients=joint.field.coefficients.tolist(),
        origin=joint.field.origin.tolist(),
        spacing=joint.field.spacing,
        points=joint.contact.points.tolist(),
        areas=joint.contact.areas.tolist(),
        femoral=joint.lines.femoral.tolist(),
        tibial=joint.lines.tibial.tolist(),
        reference_length=joint.lines.reference_length.tolist(),
    )


def state_of(flexion: complex, load: Array, ligaments: Any) -> State:
    """Trial and ligaments for the oracle; flexion may carry a complex step."""
    return State(
        flexion=flexion,  # type: ignore[arg-type]
        load=load.tolist(),
        stiffness=ligaments.stiffness.tolist(),
        strain=ligaments.reference_strain.tolist(),
    )


def random_parameters(
    model: LaxityModel, rng: np.random.Generator, *, share: float = 0.3, pct: float = 2.0
) -> Array:
    """Theta near the subject's own: stiffnesses within a share, reference strains within pct."""
    m = model.parameters.n // 2
    factor, shift = rng.uniform(1.0 - share, 1.0 + share, m), rng.uniform(-pct, pct, m)
    return np.concatenate(
        [model.parameters.center[:m] * factor, model.parameters.center[m:] + shift]
    )


def central_difference(
    function: Callable[[Array], Array], at: Array, index: int, step: float
) -> Array:
    """Slope of `function` along one argument."""
    move = np.zeros_like(at)
    move[index] = step
    return np.asarray((function(at + move) - function(at - move)) / (2.0 * step))
