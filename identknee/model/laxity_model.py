"""The laxity model: a knee under a protocol, its prediction and the prediction's exact Jacobian."""

import threading
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.mechanics.contact_points import DEFAULT_NUMBER
from identknee.mechanics.equilibria import Equilibria, solve
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.mechanics.kernel import CONVERGED, NO_EQUILIBRIUM
from identknee.mechanics.ligament_tensions import LigamentTensions, ligament_tensions
from identknee.mechanics.load_paths import Continuation, LoadPaths, load_paths
from identknee.mechanics.mesh_contact import MeshContact, mesh_contact
from identknee.mechanics.mesh_equilibrium import mesh_equilibria
from identknee.model.joint import Joint, joint_of, sheets_of
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.model.prediction import LEFT_GEOMETRY, Prediction
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.outcome import Outcome
from identknee.subject.knee import Knee

Contact = Literal["field", "mesh"]
RIM_MARGIN = 3.0  # mm
# Kernel units per unit of theta: N per kN, strain per %.
_PER_KN, _PER_PCT = 1000.0, 0.01
# Loads of a protocol (internal, varus moment, anterior, distraction, lateral force) to generalised
# loads of (varus, internal, x, y, z).
_GENERALISED = np.array(
    [
        [0.0, 1000.0, 0.0, 0.0, 0.0],
        [1000.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, -1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)


class _Last(threading.local):
    """Of each thread: the model that was last asked to predict once, and its prediction."""

    made: "tuple[LaxityModel, Prediction] | None" = None


_LAST = _Last()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaxityModel:
    """A knee under a protocol.

    Attributes
    ----------
    knee
        The subject.
    protocol
        The trials to predict.
    continuation
        How a trial's equilibrium is found: ``"continuation"`` follows the branch that starts
        unloaded in the scanned pose, the canonical answer; ``"single-step"`` puts the whole load on
        the scanned pose at once, as the paper did.
    n_points
        About how many contact points to use; None for every vertex of the tibial surfaces.
    contact
        ``"field"`` integrates pressure over the tibia (smooth, does not depend on the meshes);
        ``"mesh"`` is the paper's law with the vertices of both surfaces, for comparison: slow, and
        without derivatives, since its force jumps.
    """

    knee: Knee
    protocol: Protocol
    continuation: Continuation = "continuation"
    n_points: int | None = DEFAULT_NUMBER
    contact: Contact = "field"
    joint: Joint = field(init=False, repr=False)
    paths: LoadPaths = field(init=False, repr=False)
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        joint = joint_of(self.knee, self.n_points)
        paths = load_paths(
            np.radians(self.protocol.flexion_deg),
            self.protocol.loads @ _GENERALISED,
            joint.start_flexion,
            self.continuation,
        )
        ligaments = self.knee.ligaments
        parameters = ligament_parameters(
            [x.name for x in ligaments],
            [x.stiffness_kN for x in ligaments],
            [x.reference_strain_pct for x in ligaments],
        )
        object.__setattr__(self, "joint", joint)
        object.__setattr__(self, "paths", paths)
        object.__setattr__(self, "parameters", parameters)

    def with_protocol(self, protocol: Protocol) -> "LaxityModel":
        """The same model under another protocol; itself where it is its own."""
        return self if protocol is self.protocol else replace(self, protocol=protocol)

    def predict(
        self, theta: Array, *, derivatives: bool = True, near: Prediction | None = None
    ) -> Prediction:
        """Pose of the tibia in every trial, and how it changes with theta.

        Parameters
        ----------
        theta
            Parameter vector in the order and units of `parameters`, shape ``(p,)``.
        derivatives
            Whether the Jacobian is wanted.
        near
            A prediction at a parameter vector close by, to start from. It makes the answer faster,
            not different: what is found from it must stand the same tests.

        Raises
        ------
        ValueError
            If theta has the wrong length or holds a stiffness below 0 or a reference strain of
            -100 % or less. A trial without equilibrium is not an error: it has an outcome.
        """
        if self.contact == "mesh":
            return self._predict_on_meshes(theta, derivatives=derivatives)
        found = solve(
            self.paths,
            self.joint.start,
            self.joint.contact,
            self.joint.field,
            self.joint.lines.arrays(*self._unpacked(theta)),
            derivatives=derivatives,
            guesses=None if near is None else near.node_poses,
        )
        return self._prediction(np.array(theta, float), found, derivatives=derivatives)

    def predict_once(self, theta: Array) -> Prediction:
        """The prediction at theta with its Jacobian, not made again where it was the last one.

        Residuals, their Jacobian and the quantities of one model thus share one simulation. Each
        thread remembers one.

        Raises
        ------
        ValueError
            As `predict`; mesh contact has no derivatives.
        """
        last = _LAST.made
        if last is None or last[0] is not self or not np.array_equal(last[1].theta, theta):
            last = _LAST.made = self, self.predict(theta)
        return last[1]

    def simulate(self, theta: Array) -> Laxity:
        """The laxity table of the prediction at theta; trials that did not converge are blank."""
        prediction = self.predict(theta, derivatives=False)
        return Laxity(protocol=self.protocol, coordinates=prediction.coordinates)

    def tensions(self, prediction: Prediction) -> Array:
        """Tension of every ligament in every trial [N], shape ``(n, n_ligaments)``.

        NaN in trials that did not converge.
        """
        tensions = np.array(self._ligaments(prediction).tensions)
        tensions[~prediction.is_converged] = np.nan
        return tensions

    def tension_jacobian(self, prediction: Prediction) -> Array:
        """Exact derivatives of `tensions` by theta [N per kN, N per %], ``(n, n_ligaments, p)``.

        A parameter changes a tension directly and by moving the tibia. NaN in trials that did not
        converge.

        Raises
        ------
        ValueError
            If the prediction was made without derivatives.
        """
        if prediction.jacobian is None:
            raise ValueError("tensions have derivatives only where the prediction has them")
        found = self._ligaments(prediction)
        pose_jacobian = np.linalg.solve(
            coordinate_jacobian(prediction.poses), np.nan_to_num(prediction.jacobian)
        )
        jacobian: Array = found.by_pose @ pose_jacobian
        own, m = np.arange(found.tensions.shape[1]), self.parameters.n // 2
        jacobian[:, own, own] += _PER_KN * found.by_stiffness
        jacobian[:, own, m + own] += _PER_PCT * found.by_strain
        jacobian[~prediction.is_converged] = np.nan
        return jacobian

    def _ligaments(self, prediction: Prediction) -> LigamentTensions:
        return ligament_tensions(
            self.joint.lines,
            np.radians(self.protocol.flexion_deg),
            prediction.poses,
            *self._unpacked(prediction.theta),
        )

    def _unpacked(self, theta: Array) -> tuple[Array, Array]:
        theta = np.asarray(theta, float)
        if theta.shape != (self.parameters.n,):
            raise ValueError(
                f"theta must have {self.parameters.n} values, one for each of "
                f"{', '.join(self.parameters.names)}; got shape {theta.shape}"
            )
        m = self.parameters.n // 2
        stiffness, strain = theta[:m] * _PER_KN, theta[m:] * _PER_PCT
        allowed = np.isfinite(theta) & np.r_[stiffness >= 0.0, strain > -1.0]
        if not allowed.all():
            worst = int(np.flatnonzero(~allowed)[0])
            raise ValueError(
                f"{self.parameters.names[worst]} is {theta[worst]:g}: stiffness must be finite and "
                "at least 0 kN, reference strain finite and above -100 %"
            )
        return stiffness, strain

    def _prediction(self, theta: Array, found: Equilibria, *, derivatives: bool) -> Prediction:
        nodes = self.paths.trial_node
        codes = np.array(found.codes[nodes])
        codes[(codes == CONVERGED) & self._near_rim(found.centres[nodes])] = LEFT_GEOMETRY
        poses = found.poses[nodes]
        converged = codes == CONVERGED
        coordinates = np.where(converged[:, None], coordinates_from_pose(poses), np.nan)
        jacobian = None
        if derivatives:
            m = self.parameters.n // 2
            units = np.r_[np.full(m, _PER_KN), np.full(m, _PER_PCT)]
            jacobian = coordinate_jacobian(poses) @ (found.sensitivities[nodes] * units)
            jacobian[~converged] = np.nan
        return Prediction(
            theta=theta,
            coordinates=coordinates,
            jacobian=jacobian,
            codes=codes,
            poses=poses,
            hessians=found.hessians[nodes],
            reached=found.reached[nodes],
            centres=found.centres[nodes],
            node_poses=found.poses,
        )

    def _predict_on_meshes(self, theta: Array, *, derivatives: bool) -> Prediction:
        if derivatives:
            raise ValueError(
                "mesh contact has no derivatives, its force jumps; ask for derivatives=False, or "
                'use contact="field"'
            )
        contact = _mesh_contact(self.knee)
        lines = self.joint.lines
        found = mesh_equilibria(
            self.paths, self.joint.start, contact, lines, *self._unpacked(theta)
        )
        n = self.protocol.n
        converged = np.array([x is Outcome.CONVERGED for x in found.outcomes])
        return Prediction(
            theta=np.array(theta, float),
            coordinates=np.where(converged[:, None], coordinates_from_pose(found.poses), np.nan),
            jacobian=None,
            codes=np.where(converged, CONVERGED, NO_EQUILIBRIUM),
            poses=found.poses,
            hessians=None,
            reached=np.ones(n),
            centres=np.zeros((n, 0, 7)),
            node_poses=found.poses,
        )

    def _near_rim(self, centres: Array) -> BoolArray:
        """Whether the centre of a compartment's contact is too close to a rim, shape ``(n,)``."""
        too_close = np.zeros(len(centres), bool)
        for c, tibial in enumerate(self.joint.tibial_rims):
            margin = np.minimum(
                tibial.at(centres[:, c, 1:4]),
                self.joint.femoral_rim.at(centres[:, c, 4:7]),
            )
            too_close |= (centres[:, c, 0] > 0.0) & (margin < RIM_MARGIN)
        return too_close


@lru_cache(maxsize=4)
def _mesh_contact(knee: Knee) -> MeshContact:
    femur, tibia = sheets_of(knee)
    return mesh_contact(femur, tibia)
