"""Quantities a model predicts, each a number with its exact gradient: ligament forces, laxities."""

from dataclasses import field
from functools import lru_cache

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.model.laxity_model import LaxityModel
from identknee.model.tensions import tension_jacobian, tensions_of
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry

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
