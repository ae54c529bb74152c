"""Force of contact and menisci on either side and its centre, with derivatives."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from identknee.mechanics.contact_points import (
    ContactPlaces,
    contact_places,
    distance_bending,
    meniscus_places,
)
from identknee.mechanics.distance_field import ContactLaw, DistanceField
from identknee.mechanics.equilibria import NO_MENISCI, UNIT_LAW, ContactPoints
from identknee.mechanics.pose import place
from identknee.model.laxity_model import LaxityModel, meniscus_geometry
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, IntArray, array, declared, entry
from identknee.subject.menisci import SIDES


@declared
class CompartmentLoads:
    """Contact of c tibial surfaces in n poses: the k points that touch, and the loads.

    The force of a surface is the sum of the forces of its points, each along its own normal; the
    centre is the mean of their places, weighted by force.
    """

    touching: ContactPlaces = entry("The points that touch")
    n_poses: int = entry("Number of poses", unit="1")
    n_surfaces: int = entry("Number of tibial surfaces", unit="1")
    surface: IntArray = entry("Index of the surface of each point, shape ``(k,)``")
    places: Array = array("Positions of the points on the tibia", "point", "axis", unit="mm")
    areas: Array = array("Tributary areas of the points", "point", unit="mm2")
    force: Array = array("Force of each point", "point", unit="N")
    by_motion: Array = array(
        "Derivative of the force by the position of the point in the axes of the distance field",
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
        """Derivatives of `values` by ``a`` variables, shape ``(n, c, 4, a)``.

        Parameters
        ----------
        motion
            Derivatives of the positions of the points in the axes of the distance field, shape
            ``(k, 3, a)``.
        strengthening
            Derivatives of the forces at fixed positions, shape ``(k, a)``.
        """
        changes = np.einsum("ki,kia->ka", self.by_motion, motion) + strengthening
        values = self.values
        away = self.places - values[self.touching.pose, self.surface, 1:]
        moments = self._summed(away[:, :, None] * changes[:, None])
        with np.errstate(invalid="ignore"):
            centres = moments / values[..., :1, None]
        return np.concatenate([self._summed(changes)[:, :, None], centres], axis=2)

    def force_under(self, law: ContactLaw) -> Array:
        """Force of each point by another contact law at the same depth [N], shape ``(k,)``."""
        return np.asarray(self.areas * law.pressure(self.touching.depth)[0] * self.size)

    @property
    def size(self) -> Array:
        """Norm of the gradient of the distance at each point, nearly 1, shape ``(k,)``."""
        return np.asarray(np.linalg.norm(self.touching.outward, axis=1))

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
    owners = contact.compartment, contact.areas, places
    return _loads(touching, field, len(poses), contact.n_compartments, owners)


def meniscus_loads(
    contact: ContactPoints, field: DistanceField, flexion: Array, poses: Array, places: Array
) -> CompartmentLoads:
    """The same of the medial and the lateral meniscus; `places` are those of their points."""
    menisci = contact.menisci or NO_MENISCI
    touching = meniscus_places(contact, field, flexion, poses)
    owners = menisci.side, menisci.areas, places
    return _loads(touching, menisci.field or field, len(poses), len(SIDES), owners)


def _loads(
    touching: ContactPlaces,
    field: DistanceField,
    n_poses: int,
    n_surfaces: int,
    of_points: tuple[IntArray, Array, Array],
) -> CompartmentLoads:
    """Loads of points that touch; of all points their surface, area and place are known."""
    outward, own = touching.outward, touching.index
    # A point pushes along the slope of the distance, whose size a spline keeps only nearly at 1.
    size = np.linalg.norm(outward, axis=1)
    bending = np.einsum("kij,kj->ki", distance_bending(field, touching.femoral), outward)
    surface, areas, places = of_points
    return CompartmentLoads(
        touching=touching,
        n_poses=n_poses,
        n_surfaces=n_surfaces,
        surface=surface[own],
        places=places[own],
        areas=areas[own],
        force=touching.force * size,
        by_motion=(touching.force / size)[:, None] * bending
        - (touching.stiffness * size)[:, None] * outward,
    )


# In the order of the tibial surfaces of a knee.
COMPARTMENTS = ("medial", "lateral")
# What there is of each: the force, and where it acts in the tibia's frame.
KINDS = ("N", "x_mm", "y_mm", "z_mm")


def contact_values(prediction: Prediction) -> Array:
    """Contact force [N] and centre [mm] of each compartment and trial, ``(n, 2, 4)``.

    The force is the sum of the forces of all contact elements of the tibial surface, each along its
    own normal; the centre is the mean of their places, weighted by force, in the frame of the
    tibia's geometry: x anterior, y superior, z lateral. NaN in trials that did not converge, and
    for the centre where a compartment does not touch.
    """
    return _values(prediction, prediction.centres)


def meniscus_values(prediction: Prediction) -> Array:
    """The same of the medial and the lateral meniscus, ``(n, 2, 4)``; forces of 0 without any."""
    return _values(prediction, prediction.menisci)


def compartment_forces(prediction: Prediction) -> Array:
    """Force of contact and meniscus of each compartment and trial [N], shape ``(n, 2)``.

    NaN in trials that did not converge.
    """
    return contact_values(prediction)[:, :, 0] + meniscus_values(prediction)[:, :, 0]


def _values(prediction: Prediction, centres: Array) -> Array:
    values = np.array(centres[:, :, : len(KINDS)])
    values[values[:, :, 0] == 0.0, 1:] = np.nan
    values[~prediction.is_converged] = np.nan
    return values


# How much stronger the points press between two inputs, as deep as they are.
Strengthening = Callable[[CompartmentLoads, MechanicsInputs, MechanicsInputs], Array]
# Loads of surfaces, as `compartment_loads` makes them.
Loads = Callable[[ContactPoints, DistanceField, Array, Array, Array], CompartmentLoads]


def contact_jacobian(model: LaxityModel, prediction: Prediction, trials: Sequence[int]) -> Array:
    """Exact derivatives of `contact_values` by theta in some trials, shape ``(k, 2, 4, p)``.

    Parameters of ligaments change the contact by moving the tibia alone; the flexion, measured
    frames and the contact law also at a fixed pose. NaN in trials that did not converge.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    return _jacobian(model, prediction, trials, compartment_loads, _strengthening)


def meniscus_jacobian(model: LaxityModel, prediction: Prediction, trials: Sequence[int]) -> Array:
    """Exact derivatives of `meniscus_values` by theta in some trials, shape ``(k, 2, 4, p)``.

    Those of the place of a force are NaN where a meniscus does not press.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    return _jacobian(model, prediction, trials, meniscus_loads, _stiffening)


def _jacobian(
    model: LaxityModel,
    prediction: Prediction,
    trials: Sequence[int],
    loads_of: Loads,
    strengthening: Strengthening,
) -> Array:
    theta = prediction.theta
    jacobian = np.full((len(trials), len(COMPARTMENTS), len(KINDS), theta.size), np.nan)
    if model.parts:
        for part in model.parts:
            rows, own = part.places(trials)
            if rows.size:
                whole = part.model, part.prediction(prediction), own.tolist()
                part.spread(_jacobian(*whole, loads_of, strengthening), jacobian, rows)
        return jacobian
    amplitudes = model.amplitudes(theta)
    settings = model.extension.changes(model.setting(theta, is_changed=False), amplitudes)
    contact, field = model.surfaces(settings[-1])
    pairs = [*model.extension.contact_pairs(settings, amplitudes)]
    asked = np.array(trials, dtype=np.int64)
    found = np.flatnonzero(prediction.is_converged[asked])
    used = asked[found]
    nodes, poses = model.paths.trial_node[used], prediction.poses[used]
    flexion = settings[-1].flexion[nodes]
    points = model.joint.contact.points
    if loads_of is meniscus_loads:
        has_menisci = contact.menisci is not None
        points = meniscus_geometry(model.knee).points if has_menisci else NO_MENISCI.points
    loads = loads_of(contact, field, flexion, poses, points)
    jacobian[found] = loads.by_pose @ prediction.pose_slopes[used][:, None]
    if pairs:
        touching = loads.touching
        moved = [_motion(low, high, nodes, poses) / step for _, step, low, high in pairs]
        motion = _moved(np.stack(moved, axis=-1), points[touching.index], touching.pose)
        stronger = [strengthening(loads, low, high) / step for _, step, low, high in pairs]
        changes = loads.derivatives(motion, np.stack(stronger, axis=1))
        for i, (k, _, _, _) in enumerate(pairs):
            jacobian[found, :, :, model.n_ligament_parameters + k] += changes[..., i]
    return jacobian


# A rigid motion of a bone is known from that of four points, as far apart as those of contact.
APART = 50.0  # mm
CORNERS = np.vstack([np.zeros(3), APART * np.eye(3)])


def _motion(low: MechanicsInputs, high: MechanicsInputs, nodes: IntArray, poses: Array) -> Array:
    """How far the corners of the tibia move in the axes of the femur's distance, ``(n, 4, 3)``."""
    places = []
    for setting in (low, high):
        frames, placed = setting.frames, place(setting.flexion[nodes], poses)
        if frames is None:
            places.append(placed.to_femur(CORNERS))
        else:
            places.append(frames.to_bone(placed.to_femur(frames.to_measured(CORNERS, 1)), 0))
    return np.asarray(places[1] - places[0])


def _moved(corners: Array, points: Array, pose: IntArray) -> Array:
    """Motion of points (k, 3), each in its pose, where corners move by ``(n, 4, 3, a)``."""
    first, others = corners[:, 0], corners[:, 1:]
    turned = np.einsum("kj,kjia->kia", points / APART, (others - first[:, None])[pose])
    return np.asarray(first[pose] + turned)


def _strengthening(found: CompartmentLoads, low: MechanicsInputs, high: MechanicsInputs) -> Array:
    """How much the force of each point changes with the contact law, as deep as it is."""
    if low.law is high.law or low.law == high.law:
        return np.zeros(len(found.force))
    return found.force_under(high.law) - found.force_under(low.law)


def _stiffening(found: CompartmentLoads, low: MechanicsInputs, high: MechanicsInputs) -> Array:
    """How much the force of each point changes with the menisci, where it is."""
    if low.menisci is None or high.menisci is None:
        return np.zeros(len(found.force))
    *stiffness, height = high.menisci - low.menisci
    unit = found.force_under(UNIT_LAW)
    by_height = found.touching.stiffness * found.size
    return np.asarray(unit * np.array(stiffness)[found.surface] + by_height * height)
