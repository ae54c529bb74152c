"""Residuals against measured laxity, errors that many share, and criteria of equivalence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from identknee.laxity.noise import noise_fault
from identknee.laxity.protocol import Protocol, from_zero, nominal_flexion
from identknee.laxity.table import COORDINATES, Laxity
from identknee.mechanics.contact_points import ContactPlaces
from identknee.mechanics.equilibria import NEAR
from identknee.mechanics.memory import BEGINNINGS, HOLDS, ROTATION_SCALE
from identknee.mechanics.pose import coordinate_jacobian
from identknee.model.effects.tissues import toe_strain
from identknee.model.laxity_model import LaxityModel, observed_slopes, trial_contacts
from identknee.model.mechanics_inputs import holding_poses
from identknee.model.nuisances import flexion
from identknee.model.parameters import Parameters
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, IntArray, array, declared, entry, short_repr
from identknee.runs.marginalise import whitening
from identknee.subject.knee import Uncertainty

# How far the springs that may hold a knee have let go, the softest first.
LEVELS = np.unique(np.r_[HOLDS, BEGINNINGS])[::-1]
# What each stiffer spring adds to the lack of a trial, so that a search prefers softer springs.
STEP = 0.005
# Largest distance of an equilibrium from the pose near which it is searched for [mm, deg].
FARTHEST = np.array([NEAR] * 3 + [np.degrees(NEAR / ROTATION_SCALE)] * 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldTrials:
    """The trials of a model, each held near its measured pose.

    Attributes
    ----------
    model
        The model of the trials.
    laxity
        The measured poses. A coordinate that was not measured is taken from the trial nearest in
        flexion, or from the scanned pose.
    held_model
        The model in which a trial without equilibrium is held near its measured pose.
    """

    model: LaxityModel
    laxity: Laxity
    held_model: LaxityModel = field(init=False, repr=False)

    def __post_init__(self) -> None:
        held = self.model
        if not held.paths.is_released:
            poses = holding_poses(held.joint.start, self.laxity)
            held = replace(held, poses=poses, fallback_poses=None)
        object.__setattr__(self, "held_model", held)

    def predict(self, theta: Array) -> tuple[Array, Array, Array]:
        """Poses of the trials, each held by the softest spring that suffices, and their lack.

        Parameters
        ----------
        theta
            Parameters, shape ``(p,)``.

        Returns
        -------
        coordinates, jacobian
            Coordinates of the held poses [mm, deg], shape ``(n, 5)``, and their derivatives by
            theta, ``(n, 5, p)``.
        lack
            How far each trial is from an equilibrium: 1 where the softest spring holds the knee,
            and `STEP` more for each stiffer spring that it takes, shape ``(n,)``.
        """
        found = self.held_model.predict_once(theta)
        is_held = found.released > 0.0
        stiffer = np.searchsorted(-LEVELS, -found.released)
        # Where no spring holds the knee, the measured pose stands in, independent of theta.
        coordinates = np.where(is_held[:, None], found.held_coordinates, self.laxity.coordinates)
        if found.held_jacobian is None:  # pragma: no cover - it was asked for
            raise AssertionError
        jacobian = np.where(is_held[:, None, None], found.held_jacobian, 0.0)
        return coordinates, jacobian, 1.0 + STEP * np.where(is_held, stiffer, LEVELS.size)


Weighting = Literal["unit", "noise"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaxityResiduals:
    """Residuals of a laxity model against measured laxity.

    Attributes
    ----------
    model
        The model; its protocol is replaced by that of the data.
    laxity
        The data. Coordinates that were not measured have no residuals.
    weighting
        ``"unit"`` for plain differences in mm and deg (equation 6 of the paper), ``"noise"`` for
        differences divided by the stated errors, with the correlation that the errors of a trial
        share taken out.
    shared
        Changes of the coordinates by errors that many values share, each error of one standard
        deviation, shape ``(n, 5, k)``. They are marginalised. None if there are none.
    offset
        Added to the predicted coordinates [mm, deg], shape ``(n, 5)``; None adds nothing.
    held
        The same trials held near their measured poses, which stand in for trials without
        equilibrium; each trial then has one more residual. If None, all residuals are infinite
        where a trial has no equilibrium.

    Raises
    ------
    ValueError
        If noise weighting is asked for and a measured coordinate has no standard deviation, if
        there are shared errors without noise weighting, or if the data are relative to an unloaded
        pose that their protocol lacks.
    """

    model: LaxityModel
    laxity: Laxity
    weighting: Weighting = "unit"
    shared: Array | None = None
    offset: Array | None = None
    held: HeldTrials | None = None
    _whitening: Array = field(init=False, repr=False)
    _left: Array | None = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", self.model.with_tests(self.laxity))
        self.as_measured(self.laxity.coordinates)
        object.__setattr__(self, "_whitening", _by_trial(self.laxity, self.weighting))
        object.__setattr__(self, "_left", None)
        if self.shared is not None:
            if self.weighting == "unit":
                raise ValueError("shared errors need residuals in units of their noise")
            object.__setattr__(self, "_left", whitening(self.rows(self.shared)))

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def units(self) -> IntArray:
        """Unit of the coordinate behind each residual, shape ``(m,)``: 0 for mm, 1 for deg."""
        by_coordinate = np.array([int(name.endswith("_deg")) for name in COORDINATES])
        return np.broadcast_to(by_coordinate, (self.laxity.n, 5))[self.laxity.is_measured]

    def residuals(self, theta: Array) -> Array:
        """Predicted less measured coordinates, weighted, shape ``(m,)``.

        All are infinite where a trial with data has no equilibrium at theta and `held` is None.
        Otherwise ``n`` residuals follow that grow with the lack of each trial.
        """
        # With smooth contact the derivatives are cheap, and a fit mostly asks for them next.
        is_smooth = self.model.contact == "field"
        prediction = (
            self.model.predict_once(theta)
            if is_smooth
            else self.model.predict(theta, derivatives=False)
        )
        measured = self.laxity.is_measured
        lost = measured.any(axis=1) & ~prediction.is_converged
        coordinates = prediction.coordinates
        lack = np.zeros(lost.size)
        if lost.any():
            if self.held is None:
                return np.full(int(measured.sum()), np.inf)
            held, _, lack = self.held.predict(theta)
            coordinates = np.where(lost[:, None], held, coordinates)
            lack = np.where(lost, lack, 0.0)
        rows = self.weighted(-self._difference(coordinates))
        return rows if self.held is None else np.concatenate([rows, self._far * lack])

    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m, p)``; NaN where they are infinite.

        Raises
        ------
        ValueError
            For mesh contact, which has no derivatives.
        """
        prediction = self.model.predict_once(theta)
        jacobian = prediction.slopes
        if self.held is None:
            return self.rows(jacobian)
        lost = self.laxity.is_measured.any(axis=1) & ~prediction.is_converged
        if lost.any():
            _, held, _ = self.held.predict(theta)
            jacobian = np.where(lost[:, None, None], held, jacobian)
        rows = self.rows(jacobian)
        return np.concatenate([rows, np.zeros((self.laxity.n, rows.shape[1]))])

    @property
    def _far(self) -> Array:
        """Norm of each trial's residuals for an equilibrium at the farthest place, ``(n,)``."""
        far = np.where(self.laxity.is_measured, FARTHEST, 0.0)
        if self.weighting == "noise":
            far = np.einsum("nij,nj->ni", self._whitening, far)
        return np.asarray(np.linalg.norm(far, axis=1))

    def differences(self, theta: Array) -> Array:
        """Measured less predicted coordinates, shape ``(n, 5)``; NaN where either is missing."""
        return self._difference(self.model.predict_once(theta).coordinates)

    def rows(self, values: Array) -> Array:
        """Changes of the residuals for changes of the coordinates (n, 5, ...), ``(m, ...)``."""
        return self.weighted(self.as_measured(values))

    def log_density(self, coordinates: Array) -> Array:
        """Log density of each measured value where the model predicts `coordinates`, ``(m,)``.

        Errors are normal. The density of a value is conditional on the values before it in its
        trial, with which it may be correlated, so that all add up to the density of the table.

        Parameters
        ----------
        coordinates
            Predicted coordinates [mm, deg], shape ``(n, 5)``. Where one is NaN, the density is
            zero.
        """
        measured = self.laxity.is_measured
        with np.errstate(invalid="ignore"):
            errors = self.weighted(self.as_measured(coordinates) - self.laxity.coordinates)
        scale = np.diagonal(self._whitening, axis1=1, axis2=2)[measured]
        density = np.log(scale) - 0.5 * (errors**2 + np.log(2.0 * np.pi))
        return np.where(np.isnan(density), -np.inf, density)

    def as_measured(self, values: Array) -> Array:
        """Predicted coordinates, or their changes ``(n, 5, ...)``, counted from the data's zero."""
        return from_zero(values, self.laxity.protocol, self.laxity.zero)

    def _difference(self, predicted: Array) -> Array:
        shown = predicted if self.offset is None else predicted + self.offset
        return np.asarray(self.laxity.coordinates - self.as_measured(shown))

    def weighted(self, values: Array) -> Array:
        """Rows of errors of the measured coordinates, whitened as the residuals are.

        Parameters
        ----------
        values
            Errors of all coordinates, shape ``(n, 5, ...)``; those not measured are left out.
        """
        measured = self.laxity.is_measured
        if self.weighting == "unit":
            return np.asarray(values[measured])
        known = np.where(measured.reshape(*measured.shape, *(1,) * (values.ndim - 2)), values, 0.0)
        whitened: Array = np.einsum("nij,nj...->ni...", self._whitening, known)
        rows = whitened[measured]
        return rows if self._left is None else self._left @ rows


def _by_trial(laxity: Laxity, weighting: Weighting) -> Array:
    """The matrix (5, 5) of each trial that turns its errors into independent ones of variance 1."""
    n = len(COORDINATES)
    matrices = np.zeros((laxity.n, n, n))
    if weighting == "unit":
        return matrices
    measured = laxity.is_measured
    if laxity.sd is None or np.isnan(laxity.sd[measured]).any():
        raise ValueError(
            "weighting by noise needs a standard deviation for every measured coordinate; "
            "add the columns sd_<coordinate> or use unit weighting"
        )
    for value in (laxity.sd[measured].min(initial=1.0), laxity.sd[measured].max(initial=1.0)):
        if fault := noise_fault(float(value)):
            raise ValueError(". ".join(fault))
    shared = np.full((n, n), laxity.within_trial_correlation)
    np.fill_diagonal(shared, 1.0)
    for trial in range(laxity.n):
        used = np.flatnonzero(measured[trial])
        sd = laxity.sd[trial, used]
        covariance = sd[:, None] * shared[np.ix_(used, used)] * sd
        # Rounding and standard deviations of very different size may leave no inverse.
        try:
            matrices[trial][np.ix_(used, used)] = np.linalg.inv(np.linalg.cholesky(covariance))
        except np.linalg.LinAlgError:
            raise ValueError(
                f"the noise of trial {laxity.protocol.trials[trial]} has no inverse: the "
                f"within-trial correlation is {laxity.within_trial_correlation!r} and the standard "
                f"deviations are {sd.min():g} to {sd.max():g}; give a correlation further from "
                "its limits and standard deviations of like size"
            ) from None
    return matrices


@declared
class SurfaceBumps:
    """Gaussian bumps of one surface, whose random heights make it rough.

    Where the heights of all bumps are independent with variance 1, so is the height of the surface
    at every place; at two places that are r apart it has a correlation of about
    ``exp(-r^2 / (4 length^2))``.
    """

    centres: Array = array(
        "Centres of the bumps in the axes of the bone", "bump", "axis", unit="mm"
    )
    length: float = entry("Length of a bump [mm]")

    def heights(self, places: Array) -> Array:
        """How high each bump of height 1 is at places (n, 3) [mm] of its surface, ``(n, k)``."""
        at = places @ self.centres.T
        at -= 0.5 * (self.centres**2).sum(axis=1)
        # The norm below cancels a common factor, so the largest exponent may be 0: no underflow.
        at -= at.max(axis=1, keepdims=True)
        bumps = np.exp(at / self.length**2)
        return np.asarray(bumps / np.linalg.norm(bumps, axis=1, keepdims=True))

    def rises(self, heights: Array, moves: Array) -> Array:
        """Derivatives of the bumps' `heights` (n, k) by moving the n places.

        Parameters
        ----------
        heights
            At the places.
        moves
            Along which each place is moved, m in turn [mm], shape ``(n, m, 3)``.

        Returns
        -------
        rises
            To first order, shape ``(m, k)``.
        """
        # The heights have norm 1, so only their change orthogonal to themselves remains.
        middle = heights**2 @ self.centres
        along = np.einsum("mik,ki->mk", moves.transpose(1, 2, 0) @ heights, self.centres)
        left = np.einsum("nmi,ni->mn", moves, middle) @ heights
        return np.asarray((along - left) / self.length**2)


def surface_bumps(
    contacts: Sequence[ContactPlaces], tibial: Array, length: float
) -> tuple[SurfaceBumps, SurfaceBumps]:
    """Bumps of tibia and femur, in the axes of each bone, wherever the two touch.

    Parameters
    ----------
    contacts
        The contact of every trial.
    tibial
        All contact points in tibial axes [mm], shape ``(n, 3)``.
    length
        Length of a bump [mm].
    """
    touched = np.unique(np.concatenate([x.index for x in contacts]))
    femoral = np.concatenate([x.femoral for x in contacts])
    return (
        SurfaceBumps(centres=_apart(tibial[touched], length), length=length),
        SurfaceBumps(centres=_apart(femoral, length), length=length),
    )


def surface_changes(model: LaxityModel, prediction: Prediction, length: float) -> Array:
    """Derivatives of the measured coordinates by the heights of all bumps, shape ``(n, 5, k)``.

    Bumps lie on tibia and femur wherever these touch in any trial, and raise the surface. The unit
    is mm or deg per mm. Independent heights of standard deviation s stand for surfaces whose height
    is off by s. NaN in trials that did not converge.

    Raises
    ------
    ValueError
        If the prediction is one of mesh contact, which has no Hessians.
    """
    if prediction.hessians is None:
        raise ValueError('surface roughness needs a prediction with contact="field"')
    moved = surface_gradients(model, prediction, length)
    converged = prediction.is_converged
    hessians = np.where(converged[:, None, None], prediction.hessians, np.eye(5))
    poses = -np.linalg.solve(hessians, moved)
    seen = observed_slopes(model, prediction)
    columns: Array = seen @ coordinate_jacobian(prediction.poses) @ poses
    columns[~converged] = np.nan
    return columns


def surface_gradients(model: LaxityModel, prediction: Prediction, length: float) -> Array:
    """Derivatives of the energy's gradient by the heights of all bumps, shape ``(n, 5, k)``."""
    contacts = trial_contacts(model, prediction)
    tibial = model.joint.contact.points
    bumps = surface_bumps(contacts, tibial, length)
    return np.stack([_gradient_columns(x, tibial[x.index], *bumps) for x in contacts])


def _gradient_columns(
    contact: ContactPlaces, tibial: Array, on_tibia: SurfaceBumps, on_femur: SurfaceBumps
) -> Array:
    """Derivatives of the energy's gradient by the heights at a fixed pose, shape ``(5, k)``."""
    # A bump deepens the contact; a bump on the femur also tilts the contact normal.
    of_femur = on_femur.heights(contact.femoral)
    heights = np.hstack([on_tibia.heights(tibial), of_femur])
    columns = (contact.stiffness[:, None] * contact.deepening).T @ heights
    pushes = contact.force[:, None, None] * contact.jacobian
    columns[:, len(on_tibia.centres) :] += on_femur.rises(of_femur, pushes)
    return np.asarray(columns)


def _apart(places: Array, length: float) -> Array:
    """Some of the places: no two closer than a bump's length, and one that near to every place."""
    tree = cKDTree(places)
    is_free = np.ones(len(places), bool)
    chosen = []
    for i in range(len(places)):
        if is_free[i]:
            chosen.append(i)
            is_free[tree.query_ball_point(places[i], length)] = False
    return np.asarray(places[chosen])


# Distance within which the offset of a cartilage sheet is about the same [mm].
SURFACE_LENGTH = 10.0
ROUGHNESS_LENGTH = 3.0  # of a bump of a rough surface [mm]
# Standard deviation of a bump's height [mm]: a surface given by a formula is rough by its sampling
# alone, a mesh also by segmentation and smoothing.
FORMULA_ROUGHNESS, MESH_ROUGHNESS = 0.01, 0.02
# Standard deviation of the transition strain [%] that stands for any toe region but the formula's.
TOE = 0.15


def nuisance_changes(model: LaxityModel, theta: Array) -> tuple[Array, Array]:
    """Derivatives of all coordinates by nuisances, and their prior standard deviations.

    The nuisances are rough surfaces, the shared errors that the knee states, and a toe region of
    the ligaments other than that of the equations, unless the model has it as an effect.

    Returns
    -------
    changes
        Derivatives by each nuisance, shape ``(n, 5, k)``; NaN in trials that did not converge.
    spreads
        Prior standard deviation of each nuisance, shape ``(k,)``.
    """
    rough = surface_changes(model, model.predict_once(theta), ROUGHNESS_LENGTH)
    height = MESH_ROUGHNESS if model.knee.femur_distance is None else FORMULA_ROUGHNESS
    changes, spreads = [rough], [np.full(rough.shape[2], height)]
    toe = toe_strain()
    if toe.name not in {x.name for x in model.effects}:
        found = model.with_effects([*model.effects, toe]).predict(np.r_[theta, 0.0])
        changes.append(found.slopes[:, :, -1:])
        spreads.append(np.array([TOE]))
    if has_shared_errors(model.knee.uncertainty):
        shared = shared_errors(model, theta)
        changes.append(shared)
        spreads.append(np.ones(shared.shape[2]))
    return np.concatenate(changes, axis=2), np.concatenate(spreads)


def has_shared_errors(uncertainty: Uncertainty) -> bool:
    """Whether a knee states errors that are marginalised without parameters."""
    x = uncertainty
    return max(x.zero_mm, x.zero_deg, x.trial_flexion_deg, x.surface_mm) > 0.0


def with_shared(residuals: LaxityResiduals, columns: Array) -> LaxityResiduals:
    """The residuals with further errors that many values share, shape ``(n, 5, k)``."""
    own = residuals.shared
    return replace(
        residuals, shared=columns if own is None else np.concatenate([own, columns], axis=2)
    )


def shared_errors(model: LaxityModel, theta: Array) -> Array:
    """Change of the coordinates by errors of one standard deviation, shape ``(n, 5, k)``.

    The errors are, where the knee states them: an offset of each coordinate for every nominal
    flexion angle of a mounting, an error of flexion for every trial, and smooth offsets of the
    cartilage sheets. The last two are linearised at `theta`, and NaN in trials that have no
    equilibrium there.
    """
    stated = model.knee.uncertainty
    sizes = [stated.zero_deg if x.endswith("_deg") else stated.zero_mm for x in COORDINATES]
    mounting, angle = model.protocol.mounting, np.array(model.protocol.flexion_deg)
    for each in np.unique(mounting):
        # A robot's readings scatter a little around each nominal angle.
        angle[mounting == each] = nominal_flexion(model.protocol.select(mounting == each))
    places, group = np.unique(np.column_stack([mounting, angle]), axis=0, return_inverse=True)
    columns = np.zeros((model.protocol.n, len(COORDINATES), len(places), len(COORDINATES)))
    for trial, place in enumerate(group):
        columns[trial, :, place, :] = np.diag(sizes)
    flat = columns.reshape(*columns.shape[:2], -1)
    parts = [flat[:, :, np.tile(np.array(sizes) > 0.0, len(places))]]
    if stated.trial_flexion_deg > 0.0:
        offset = flexion(stated.trial_flexion_deg)
        others = [x for x in model.effects if x.name != offset.name]
        extended = model.with_effects([*others, offset])
        known = dict(zip(model.parameters.names, theta, strict=True))
        here = np.array([known.get(name, 0.0) for name in extended.parameters.names])
        slopes = stated.trial_flexion_deg * extended.predict(here).slopes[:, :, -1]
        parts.append(np.asarray(np.eye(len(slopes))[:, None, :] * slopes[:, :, None]))
    if stated.surface_mm > 0.0:
        changes = surface_changes(model, model.predict(theta), SURFACE_LENGTH)
        parts.append(stated.surface_mm * changes)
    return np.concatenate(parts, axis=2)


# "The kinematic error remained below 1 mm and 1.2 deg for all conditions" in the paper, a
# root-mean-square difference over the trials of a flexion angle.
PAPER_LIMITS: Mapping[str, float] = MappingProxyType(
    {"anterior_drawer_mm": 1.0, "varus_deg": 1.2, "internal_deg": 1.2}
)


def rms_blocks(
    residuals: LaxityResiduals, limits: Mapping[str, float] = PAPER_LIMITS
) -> dict[str, Array]:
    """Weights of the residuals of each flexion angle and coordinate, shape ``(m,)`` each.

    The sum of squares of the weighted residuals is the mean square of a coordinate over the trials
    at a flexion angle, over its limit squared: it is 1 where the root-mean-square is at the limit.
    Names read ``"internal_deg@30"``.

    Parameters
    ----------
    residuals
        Unit-weighted, so that they are in mm and deg.
    limits
        Largest root-mean-square by coordinate [mm, deg]; coordinates not named have no limit.

    Raises
    ------
    ValueError
        If the residuals are weighted by noise, a limit is not greater than 0, or no coordinate
        with a limit was measured.
    """
    if residuals.weighting != "unit":
        raise ValueError('a limit in mm and deg needs residuals with weighting="unit"')
    for name, limit in limits.items():
        if name not in COORDINATES or not 0 < limit < np.inf:
            raise ValueError(
                f"the limit of {name} is {limit:g}: limits are greater than 0 and belong to "
                f"{', '.join(COORDINATES)}"
            )
    laxity = residuals.laxity
    trial, coordinate = np.nonzero(laxity.is_measured)
    flexion = laxity.protocol.flexion_deg[trial]
    blocks = {}
    for angle in np.unique(flexion):
        for name, limit in limits.items():
            rows = (flexion == angle) & (coordinate == COORDINATES.index(name))
            if rows.any():
                weight = 1.0 / (limit * np.sqrt(rows.sum()))
                blocks[f"{name}@{angle:g}"] = np.where(rows, weight, 0.0)
    if not blocks:
        raise ValueError(
            f"none of {', '.join(limits)} was measured, so that nothing limits the difference; "
            "use the noise criterion"
        )
    return blocks


def largest_loads(protocol: Protocol) -> IntArray:
    """Indices of the trials with the largest load of their kind at their flexion angle, ascending.

    Loads are of one kind if their components have the same signs, in the same experiment and state
    of the knee.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> protocol = load_protocol("seed63")
    >>> [protocol.trials[i] for i in largest_loads(protocol)][:2]
    ['flexion0_varus-10Nm', 'flexion0_unloaded']
    """
    largest: dict[tuple[float, ...], int] = {}
    sizes, series = np.abs(protocol.loads).sum(axis=1), protocol.series
    for i in range(protocol.n):
        signs = np.sign(protocol.loads[i]).tolist()
        kind = (float(series[i]), float(protocol.flexion_deg[i]), *signs)
        if kind not in largest or sizes[i] > sizes[largest[kind]]:
            largest[kind] = i
    return np.sort(list(largest.values()))
