"""Scalar predictions by name, with derivatives: tensions, strains, contact, coordinates."""

from collections.abc import Sequence
from dataclasses import field
from functools import lru_cache

import numpy as np

from identknee.laxity.protocol import ABSOLUTE, Protocol, from_zero, zero_trials
from identknee.laxity.table import COORDINATES
from identknee.model.contact_loads import (
    COMPARTMENTS,
    KINDS,
    contact_jacobian,
    contact_values,
    meniscus_jacobian,
    meniscus_values,
)
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import (
    StructureLoads,
    index_of,
    structure_loads,
    structure_names,
    structure_values,
)
from identknee.model.parameters import FreeParameters, Parameters
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, declared, entry
from identknee.subject.menisci import MENISCI

TENSION, STRAIN, CONTACT, MENISCUS = "tension_N", "strain_pct", "contact", "meniscus"
AT = "@"
FORMS = (
    f"NAME.{TENSION}{AT}TRIAL or NAME.{STRAIN}{AT}TRIAL of a ligament, a group or a structure that "
    f"an effect adds; {CONTACT}.medial_N{AT}TRIAL or {CONTACT}.lateral_N{AT}TRIAL; the place of "
    f"that force, {CONTACT}.medial_x_mm{AT}TRIAL and so on with lateral, y and z; the same of "
    f"{MENISCUS} where the model has menisci; or a coordinate such as varus_deg{AT}TRIAL"
)
# Thetas remembered: callers ask for many quantities of one model at one theta.
_KEPT = 64


@declared
class PredictedQuantity:
    """A number that a model predicts in one trial, by name.

    =========================== ====================================================================
    ``NAME.tension_N``          Tension of a ligament, a group or a structure that an effect adds:
                                the sum over its lines [N].
    ``NAME.strain_pct``         Their mean strain, weighted by stiffness; negative where it is slack
                                [%].
    ``contact.medial_N``        Contact force of the medial compartment: the sum of the forces of
                                its contact elements, each along its own normal [N].
    ``contact.lateral_N``       Contact force of the lateral compartment.
    ``contact.medial_x_mm``     Where that force acts, the mean place of the elements weighted by
                                force, in the tibia's frame: x anterior, y superior, z lateral [mm].
                                Also ``_y_mm`` and ``_z_mm``, and ``contact.lateral_...``.
    ``meniscus.medial_N``       Force of the medial meniscus, which is no part of the contact force;
                                also ``_x_mm``, ``_y_mm`` and ``_z_mm``, and
                                ``meniscus.lateral_...``.
    ``varus_deg`` and so on     A coordinate of the laxity table.
    =========================== ====================================================================

    Raises
    ------
    ValueError
        If the model has no such quantity or trial.
    """

    model: LaxityModel = entry(
        "The model; its protocol has the trial, which need not be one of the data's"
    )
    what: str = entry('Name without the trial, for example ``"ACL.tension_N"``')
    trial: str = entry("Name of the trial")
    name: str = field(init=False)
    unit: str = field(init=False)
    _place: tuple[str, int, int] = field(init=False, repr=False)
    _trial: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        unit = self.what.rpartition("_")[2]
        made = {
            "_place": _place(self.model, self.what),
            "_trial": index_of(self.trial, self.model.protocol.trials, "trial"),
            "name": f"{self.what}{AT}{self.trial}",
            "unit": "%" if unit == "pct" else unit,
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)

    def value(self, prediction: Prediction) -> float:
        """Value of the quantity in a prediction of the model.

        NaN in a trial without equilibrium, and for the place of contact where nothing touches.
        """
        kind, i, j = self._place
        if kind in (CONTACT, MENISCUS):
            of_sides = contact_values if kind == CONTACT else meniscus_values
            return float(of_sides(prediction)[self._trial, i, j])
        if kind in (TENSION, STRAIN):
            name = self.what.rpartition(".")[0]
            values = structure_values(self.model, prediction, name)
            return float(values[kind == STRAIN][self._trial])
        return float(prediction.coordinates[self._trial, i])

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient of the quantity, shape ``(p,)``; NaN where it has no value.

        All quantities at one theta share a simulation, also with the residuals of the model if
        these were evaluated there last.

        Raises
        ------
        ValueError
            As `LaxityModel.predict`, and for mesh contact, which has no derivatives.
        """
        at = np.asarray(theta, np.float64).tobytes()
        kind, i, j = self._place
        if kind == CONTACT:
            value = contact_values(_prediction(self.model, at))[self._trial, i, j]
            return float(value), _contact_jacobian(self.model, at, self._trial)[i, j]
        if kind == MENISCUS:
            value = meniscus_values(_prediction(self.model, at))[self._trial, i, j]
            return float(value), _meniscus_jacobian(self.model, at, self._trial)[i, j]
        if kind == COORDINATE:
            found = _prediction(self.model, at)
            return float(found.coordinates[self._trial, i]), found.slopes[self._trial, i]
        loads = _structure_loads(self.model, at)
        values, slopes = (
            (loads.tensions, loads.tension_jacobian)
            if kind == TENSION
            else (loads.strains, loads.strain_jacobian)
        )
        return float(values[self._trial, i]), slopes[self._trial, i]


COORDINATE = "coordinate"


def quantity_place(model: LaxityModel, what: str) -> tuple[str, int]:
    """Kind of a predicted quantity, and its index among the structures or the compartments.

    Raises
    ------
    ValueError
        If the model has no such quantity.
    """
    kind, place, _ = _place(model, what)
    return kind, place


def _place(model: LaxityModel, what: str) -> tuple[str, int, int]:
    """Kind of a quantity, and its one or two indices among quantities of that kind."""
    owner, dot, kind = what.rpartition(".")
    if dot and kind in (TENSION, STRAIN):
        return kind, index_of(owner, structure_names(model), "ligament"), 0
    side, _, kind = kind.partition("_")
    if owner == CONTACT and side in COMPARTMENTS and kind in KINDS:
        return CONTACT, COMPARTMENTS.index(side), KINDS.index(kind)
    if owner == MENISCUS and side in COMPARTMENTS and kind in KINDS:
        if not any(x.name == MENISCI for x in model.effects):
            raise ValueError(
                f"{what!r} needs menisci, and the model has none; add [menisci] to subject.toml"
            )
        return MENISCUS, COMPARTMENTS.index(side), KINDS.index(kind)
    if dot:
        raise ValueError(f"{what!r} is not the name of a predicted quantity; write {FORMS}")
    if what not in COORDINATES:
        raise ValueError(
            f"there is no coordinate {what!r}; there are {', '.join(COORDINATES)}; or write {FORMS}"
        )
    return COORDINATE, COORDINATES.index(what), 0


def quantity_named(model: LaxityModel, name: str) -> PredictedQuantity:
    """The predicted quantity of a name such as ``"ACL.tension_N@TRIAL"``.

    Raises
    ------
    ValueError
        If the name has none of the forms of `PredictedQuantity`, or the model lacks what it names.
    """
    what, at, trial = name.partition(AT)
    if not at:
        raise ValueError(f"{name!r} is not the name of a predicted quantity; write {FORMS}")
    return PredictedQuantity(model=model, what=what, trial=trial)


def force_names(model: LaxityModel, trials: Sequence[str]) -> list[str]:
    """Names of the tensions of all ligaments in some trials; the lines of a group count as one."""
    return [f"{x}.{TENSION}{AT}{trial}" for trial in trials for x in model.tied.names]


def ligament_forces(
    model: LaxityModel, protocol: Protocol | None = None
) -> list[PredictedQuantity]:
    """The force of every ligament in every trial of the model's protocol, or of another one.

    The lines of a group count as one. All forces at one theta take one simulation.
    """
    under = model if protocol is None else model.with_protocol(protocol)
    return [quantity_named(under, x) for x in force_names(under, under.protocol.trials)]


@lru_cache(maxsize=_KEPT)
def _prediction(model: LaxityModel, theta: bytes) -> Prediction:
    return model.predict_once(np.frombuffer(theta))


@lru_cache(maxsize=_KEPT)
def _structure_loads(model: LaxityModel, theta: bytes) -> StructureLoads:
    return structure_loads(model, _prediction(model, theta))


@lru_cache(maxsize=_KEPT)
def _contact_jacobian(model: LaxityModel, theta: bytes, trial: int) -> Array:
    return np.asarray(contact_jacobian(model, _prediction(model, theta), [trial])[0])


@lru_cache(maxsize=_KEPT)
def _meniscus_jacobian(model: LaxityModel, theta: bytes, trial: int) -> Array:
    return np.asarray(meniscus_jacobian(model, _prediction(model, theta), [trial])[0])


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
