"""Scalar predictions by name, with derivatives: ligament tensions and coordinates of trials."""

from dataclasses import field
from functools import lru_cache

import numpy as np

from identknee.laxity.protocol import ABSOLUTE, Protocol, from_zero, zero_trials
from identknee.laxity.table import COORDINATES
from identknee.mechanics.ligament_tensions import LigamentTensions, ligament_tensions
from identknee.model.laxity_model import LaxityModel, Prediction
from identknee.model.mechanics_inputs import PER_KN, PER_PCT, MechanicsInputs
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry


def tensions_of(model: LaxityModel, prediction: Prediction) -> Array:
    """Tension of every ligament in every trial [N], shape ``(n, n_ligaments)``.

    That of all its lines where an effect splits it into bundles. NaN in trials that did not
    converge.
    """
    setting = model.setting(prediction.theta)
    lines = _lines(model, setting, prediction)
    tensions: Array = lines.tensions @ setting.owned(len(model.knee.ligaments))
    tensions[~prediction.is_converged] = np.nan
    return tensions


def tension_jacobian(model: LaxityModel, prediction: Prediction) -> Array:
    """Exact derivatives of `tensions_of` by theta, shape ``(n, n_ligaments, p)``.

    In N per unit of each parameter: it changes a tension directly and by moving the tibia. NaN in
    trials that did not converge.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    if prediction.pose_jacobian is None:
        raise ValueError("tensions have derivatives only where the prediction has them")
    setting, m = model.setting(prediction.theta), len(model.knee.ligaments)
    found, owned = _lines(model, setting, prediction), setting.owned(m)
    by_pose = np.einsum("nla,lm->nma", found.by_pose, owned)
    jacobian: Array = by_pose @ np.nan_to_num(prediction.pose_jacobian)
    own = np.arange(m)
    jacobian[:, own, own] += PER_KN * (found.by_stiffness * setting.share) @ owned
    jacobian[:, own, m + own] += PER_PCT * found.by_strain @ owned
    unchanged = model.setting(prediction.theta, is_changed=False)
    amplitudes = model.amplitudes(prediction.theta)
    for k, move in enumerate(model.extension.moves()):
        low, high = (
            _lines(model, model.extension.change(unchanged, amplitudes + s * move), prediction)
            for s in (-1.0, 1.0)
        )
        jacobian[:, :, 2 * m + k] += (high.tensions - low.tensions) @ owned / (2.0 * move[k])
    jacobian[~prediction.is_converged] = np.nan
    return jacobian


def _lines(
    model: LaxityModel, setting: MechanicsInputs, prediction: Prediction
) -> LigamentTensions:
    """Tensions of all lines at the poses of a prediction."""
    return ligament_tensions(
        setting.measured_lines,
        setting.flexion[model.paths.trial_node],
        prediction.poses,
        setting.stiffness,
        setting.reference_strain,
    )


TENSION = "tension_N"
AT = "@"
# Of one model at one theta, many quantities are asked for.
_KEPT = 64


@declared
class PredictedQuantities:
    """All a model predicts at one theta, for n trials, m ligaments and p parameters."""

    tensions: Array = array(
        "Tension of each ligament; NaN, here and below, in trials that did not converge",
        *("trial", "ligament"),
        unit="N",
    )
    tension_jacobian: Array = array("Their derivatives by theta", "trial", "ligament", "parameter")
    coordinates: Array = array(
        "Lateral shift, anterior drawer, distraction [mm], varus, internal rotation [deg]",
        *("trial", "coordinate"),
    )
    coordinate_jacobian: Array = array(
        "Their derivatives by theta", "trial", "coordinate", "parameter"
    )


@declared
class LigamentForce:
    """The tension of one ligament in one trial.

    Raises
    ------
    ValueError
        If the model has no such ligament or trial.
    """

    model: LaxityModel = entry(
        "The model; its protocol has the trial, which need not be one of the data's"
    )
    ligament: str = entry("Name of the ligament")
    trial: str = entry("Name of the trial")
    name: str = field(init=False)
    unit: str = field(init=False, default="N")
    _place: tuple[int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        ligaments = [x.name for x in self.model.knee.ligaments]
        place = (
            _index(self.trial, self.model.protocol.trials, "trial"),
            _index(self.ligament, ligaments, "ligament"),
        )
        object.__setattr__(self, "_place", place)
        object.__setattr__(self, "name", f"{self.ligament}.{TENSION}{AT}{self.trial}")

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """The force [N] and its gradient, shape ``(p,)``; NaN where the trial has no prediction."""
        found = predicted_quantities(self.model, theta)
        return float(found.tensions[self._place]), found.tension_jacobian[self._place]


@declared
class PredictedLaxity:
    """One coordinate of the pose in one trial.

    Raises
    ------
    ValueError
        If there is no such coordinate, or the model has no such trial.
    """

    model: LaxityModel = entry(
        "The model; its protocol has the trial, which need not be one of the data's"
    )
    coordinate: str = entry('A column of the laxity table, for example ``"internal_deg"``')
    trial: str = entry("Name of the trial")
    name: str = field(init=False)
    unit: str = field(init=False)
    _place: tuple[int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        place = (
            _index(self.trial, self.model.protocol.trials, "trial"),
            _index(self.coordinate, COORDINATES, "coordinate"),
        )
        object.__setattr__(self, "_place", place)
        object.__setattr__(self, "name", f"{self.coordinate}{AT}{self.trial}")
        object.__setattr__(self, "unit", self.coordinate.rpartition("_")[2])

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """The coordinate and its gradient, shape ``(p,)``; NaN where there is no prediction."""
        found = predicted_quantities(self.model, theta)
        return float(found.coordinates[self._place]), found.coordinate_jacobian[self._place]


def quantity_named(model: LaxityModel, name: str) -> LigamentForce | PredictedLaxity:
    """The predicted quantity of a name such as ``"ACL.tension_N@TRIAL"`` or ``"varus_deg@TRIAL"``.

    Raises
    ------
    ValueError
        If the name has not this form, or the model lacks the ligament, coordinate or trial.
    """
    what, at, trial = name.partition(AT)
    if not at:
        raise ValueError(
            f"{name!r} is not the name of a predicted quantity; write LIGAMENT.{TENSION}{AT}TRIAL "
            f"or a coordinate such as varus_deg{AT}TRIAL"
        )
    if what.endswith(f".{TENSION}"):
        return LigamentForce(model=model, ligament=what.removesuffix(f".{TENSION}"), trial=trial)
    return PredictedLaxity(model=model, coordinate=what, trial=trial)


def ligament_forces(model: LaxityModel, protocol: Protocol | None = None) -> list[LigamentForce]:
    """The force of every ligament in every trial of the model's protocol, or of another one.

    They share their simulations: all of them at one theta cost one.
    """
    under = model if protocol is None else model.with_protocol(protocol)
    return [
        LigamentForce(model=under, ligament=ligament.name, trial=trial)
        for trial in under.protocol.trials
        for ligament in under.knee.ligaments
    ]


def predicted_quantities(model: LaxityModel, theta: Array) -> PredictedQuantities:
    """Ligament forces and laxities in every trial at `theta`, with Jacobians, by one simulation.

    It is that of the model's residuals where they were asked for last; and the last ones asked for
    are kept, so that asking again at the same theta costs nothing.

    Raises
    ------
    ValueError
        As `LaxityModel.predict`, and for mesh contact, which has no derivatives.
    """
    return _predicted(model, np.asarray(theta, np.float64).tobytes())


@lru_cache(maxsize=_KEPT)
def _predicted(model: LaxityModel, theta: bytes) -> PredictedQuantities:
    prediction = model.predict_once(np.frombuffer(theta))
    if prediction.jacobian is None:  # pragma: no cover - predict was asked for it
        raise AssertionError
    return PredictedQuantities(
        tensions=tensions_of(model, prediction),
        tension_jacobian=tension_jacobian(model, prediction),
        coordinates=prediction.coordinates,
        coordinate_jacobian=prediction.jacobian,
    )


def _index(name: str, names: "tuple[str, ...] | list[str]", kind: str) -> int:
    if name not in names:
        shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        raise ValueError(f"there is no {kind} {name!r}; there are {shown}")
    return names.index(name)


@declared
class LaxityOutputs:
    """Coordinates of every trial of a model as functions of its free parameters.

    Raises
    ------
    ValueError
        If the number of groups differs, or a pose is needed that the protocol lacks.
    """

    model: LaxityModel = entry("The model under its protocol of n trials")
    groups: tuple[str, ...] = entry(
        "Name of the group of every coordinate of every trial, trial after trial, ``5 n`` in all"
    )
    free: FreeParameters = entry(
        "The parameters of the model that vary, and the values of the others"
    )
    zero: str = entry(
        "What coordinates are counted from, as in `identknee.Laxity`", default=ABSOLUTE
    )

    def __post_init__(self) -> None:
        wanted = len(COORDINATES) * self.model.protocol.n
        if len(self.groups) != wanted:
            raise ValueError(
                f"{wanted} outputs need as many names of groups, got {len(self.groups)}"
            )
        if self.zero != ABSOLUTE:
            zero_trials(self.model.protocol, self.zero)

    @property
    def parameters(self) -> Parameters:
        """The free parameters of the model."""
        return self.free.parameters

    def evaluate(self, theta: Array) -> Array:
        """Coordinates of all trials [mm, deg], shape ``(5 n,)``; NaN where one did not converge."""
        everything = self.free.expand(theta)
        coordinates = self.model.predict(everything, derivatives=False).coordinates
        return np.asarray(from_zero(coordinates, self.model.protocol, self.zero).ravel())
