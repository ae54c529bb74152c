"""Residuals of limits of plausibility: one for each limit, however many trials there are."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from identknee.laxity.protocol import LOADS, WAYS, Protocol, dominant_loads
from identknee.model.contact_loads import (
    COMPARTMENTS,
    compartment_forces,
    contact_jacobian,
    meniscus_jacobian,
)
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import (
    StructureLoads,
    strains_of,
    structure_loads,
    tensions_of,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, BoolArray, declared, entry, short_repr
from identknee.runs.errors import ValueRefused
from identknee.subject.menisci import MENISCI
from identknee.subject.plausibility import CONTACT, TENSION, Limit

# The smooth maximum of n values exceeds the largest by at most this times ln(n): 0.3 N for 24
# trials. A trial given twice raises it by 0.07 N.
SOFTNESS = {"N": 0.1, "%": 0.005}
VARUS = LOADS.index("varus_moment_Nm")
NUMBER = re.compile(r"-?[0-9]+(?:\.[0-9]+)?")
UNITS_OF_LOADS = {"moment": ("Nm", "N·m"), "force": ("N",)}
HALF_LOG_TWO_PI = 0.5 * np.log(2.0 * np.pi)
# Residuals below this, about eight standard deviations below the strength, count as zero: the slope
# would divide by them.
NEGLIGIBLE = 1e-8


@declared
class LimitAtFit:
    """A limit of plausibility, and the value at a fit."""

    name: str = entry("What is limited")
    form: str = entry("Strength (largest over trials), within (mean over trials), or normal")
    value: float = entry("Value at the fit", unit="N or %")
    size: float = entry(
        "Mean of the strength or value, or where the half-normal begins", unit="N or %"
    )
    spread: float = entry("Its standard deviation over specimens, or scale", unit="N or %")
    deviance: float = entry("What it adds to the deviance", unit="1")
    source: str = entry("Where the limit is from")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LimitResiduals:
    """How far a model is beyond each limit of its knee, as residuals of unit variance.

    Attributes
    ----------
    model
        The model under the protocol of the data.
    limits
        The limits. Those for loads that no trial is under are left out.
    is_everywhere
        Whether a standard load without equilibrium gives no residual, as in a search that begins
        anywhere; otherwise all residuals are infinite then. Trials of the data without equilibrium
        are always left out here: the residuals of the table count them.

    Raises
    ------
    ValueError
        If the model lacks a ligament that a limit names, or a standard load cannot be read.
    """

    model: LaxityModel
    limits: Sequence[Limit]
    is_everywhere: bool = False
    _members: tuple[tuple[int, ...], ...] = field(init=False, repr=False)
    _counts: tuple[BoolArray, ...] = field(init=False, repr=False)
    _standard: LaxityModel | None = field(init=False, repr=False)
    _at: tuple[int, ...] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Find what the limits name."""
        protocol = self.model.protocol
        is_counted = {
            "all": np.ones(protocol.n, bool),
            "no varus moment": dominant_loads(protocol).axis != VARUS,
            "nearly unloaded": dominant_loads(protocol).axis < 0,
        }
        used = [x for x in self.limits if x.load or is_counted[x.trials].any()]
        loads = list(dict.fromkeys(x.load for x in used if x.load))
        standard = self.model.with_protocol(standard_loads(loads)) if loads else None
        made = {
            "limits": tuple(used),
            "_members": tuple(_members(self.model, x) for x in used),
            "_counts": tuple(is_counted[x.trials] for x in used),
            "_standard": standard,
            "_at": tuple(loads.index(x.load) if x.load else -1 for x in used),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def n(self) -> int:
        """Number of limits."""
        return len(self.limits)

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(n,)``; 0 where nothing is beyond a limit."""
        values = self.values(theta)
        left = np.array([_residual(x, v)[0] for x, v in zip(self.limits, values, strict=True)])
        if np.isnan(left).any() and not self.is_everywhere and self._is_standard_lost(theta):
            return np.full(self.n, np.inf)
        return np.asarray(np.nan_to_num(left))

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by theta, shape ``(n, p)``."""
        by_value = [
            _residual(limit, value)[1] if np.isfinite(value) else 0.0
            for limit, value in zip(self.limits, self.values(theta), strict=True)
        ]
        # Slopes take longer than a simulation, and few limits are near enough to need them.
        slopes = self._found(theta, has_slopes=True, wanted=[x != 0.0 for x in by_value])
        rows = [factor * row for factor, (_, row) in zip(by_value, slopes, strict=True)]
        return np.array(rows).reshape(self.n, theta.size)

    def values(self, theta: Array) -> Array:
        """The limited values: smooth maximum, mean, or value under the standard load, ``(n,)``.

        NaN where none of the trials of a limit has an equilibrium.
        """
        return np.array([value for value, _ in self._found(theta, has_slopes=False)])

    def at_fit(self, theta: Array) -> tuple[LimitAtFit, ...]:
        """Each limit with the value of the model."""
        found = zip(self.limits, self.values(theta), self.residuals(theta), strict=True)
        return tuple(
            LimitAtFit(
                name=x.name,
                form=x.form,
                value=float(value),
                size=x.size,
                spread=x.spread,
                deviance=float(left**2),
                source=x.source,
            )
            for x, value, left in found
        )

    def _found(
        self, theta: Array, *, has_slopes: bool, wanted: Sequence[bool] | None = None
    ) -> list[tuple[float, Array]]:
        """Value and derivatives of the quantity of each limit; zeros where it is not wanted."""
        touched = [x for i, x in enumerate(self._counts) if not self._members[i]]
        in_contact = np.flatnonzero(np.any(touched, axis=0)).tolist() if touched else []
        of_trials = _Loads(self.model, theta, has_slopes=has_slopes, in_contact=in_contact)
        of_standard = None
        if self._standard is not None:
            every = range(self._standard.protocol.n)
            of_standard = _Loads(self._standard, theta, has_slopes=has_slopes, in_contact=every)
        found = []
        for i, limit in enumerate(self.limits):
            if wanted is not None and not wanted[i]:
                found.append((0.0, np.zeros(theta.size)))
            elif limit.load and of_standard is not None:
                counts = np.arange(self._standard.protocol.n) == self._at[i]  # type: ignore[union-attr]
                found.append(of_standard.reduced(limit, self._members[i], counts))
            else:
                found.append(of_trials.reduced(limit, self._members[i], self._counts[i]))
        return found

    def _is_standard_lost(self, theta: Array) -> bool:
        standard = self._standard
        return standard is not None and not standard.predict_once(theta).is_converged.all()


class _Loads:
    """Tensions, strains and contact of all trials at one theta, each computed on first use."""

    def __init__(
        self, model: LaxityModel, theta: Array, *, has_slopes: bool, in_contact: Sequence[int]
    ) -> None:
        # Trials whose contact is asked for.
        self.in_contact = list(in_contact)
        self.model, self.has_slopes, self.n_parameters = model, has_slopes, theta.size
        self.prediction = model.predict_once(theta)
        self._known: dict[str, tuple[Array, Array]] = {}

    def reduced(
        self, limit: Limit, members: tuple[int, ...], counts: BoolArray
    ) -> tuple[float, Array]:
        """The quantity of a limit and its derivatives; NaN where no trial has an equilibrium."""
        values, slopes = self._by_trial(limit.what, members)
        if limit.less:
            other, other_slopes = self._by_trial(limit.less, members)
            values, slopes = values - other, slopes - other_slopes
        used = counts & self.prediction.is_converged
        if not used.any():
            return np.nan, np.zeros(self.n_parameters)
        values, slopes = values[used], slopes[used]
        if limit.form == "strength":
            soft = SOFTNESS[limit.unit]
            flat, rows = values.ravel(), slopes.reshape(values.size, self.n_parameters)
            known = np.isfinite(flat)
            if not known.any():
                return np.nan, np.zeros(self.n_parameters)
            flat, rows = flat[known], rows[known]
            total = np.logaddexp.reduce(flat / soft)
            return float(soft * total), np.exp(flat / soft - total) @ rows
        whole = values.sum(axis=1)
        return float(whole.mean()), slopes.sum(axis=1).mean(axis=0)

    def _by_trial(self, what: str, members: tuple[int, ...]) -> tuple[Array, Array]:
        """A quantity in every trial, shapes ``(n, k)`` and ``(n, k, p)``.

        For tensions k is 1, the sum over members; for strains k is the number of members.
        """
        owner, _, kind = what.rpartition(".")
        if owner == CONTACT:
            side = COMPARTMENTS.index(kind.partition("_")[0])
            values, slopes = self._of("contact")
            return values[:, side, None], slopes[:, side, None]
        values, slopes = self._of(kind)
        values, slopes = values[:, members], slopes[:, members]
        if kind == TENSION:
            return (
                np.nan_to_num(values).sum(axis=1, keepdims=True),
                np.nan_to_num(slopes).sum(axis=1, keepdims=True),
            )
        return values, slopes

    def _of(self, kind: str) -> tuple[Array, Array]:
        if kind not in self._known:
            self._known[kind] = self._computed(kind)
        return self._known[kind]

    def _computed(self, kind: str) -> tuple[Array, Array]:
        model, made = self.model, self.prediction
        if kind == "contact":
            # The whole load of a compartment, through cartilage and meniscus.
            values = compartment_forces(made)
            slopes = np.zeros((*values.shape, self.n_parameters))
            if self.has_slopes:
                found = contact_jacobian(model, made, self.in_contact)[:, :, 0]
                if any(x.name == MENISCI for x in model.effects):
                    found = found + meniscus_jacobian(model, made, self.in_contact)[:, :, 0]
                slopes[self.in_contact] = found
            return values, slopes
        if not self.has_slopes:
            values = (tensions_of if kind == TENSION else strains_of)(model, made)
            return values, np.zeros((*values.shape, self.n_parameters))
        n, loads = len(model.knee.ligaments), self._structures
        if kind == TENSION:
            return loads.tensions[:, :n], loads.tension_jacobian[:, :n]
        return loads.strains[:, :n], loads.strain_jacobian[:, :n]

    @cached_property
    def _structures(self) -> StructureLoads:
        return structure_loads(self.model, self.prediction)


def _members(model: LaxityModel, limit: Limit) -> tuple[int, ...]:
    """Indices of the ligaments of a limit; none for contact."""
    owner = limit.what.rpartition(".")[0]
    if owner == CONTACT:
        return ()
    names = [x.name for x in model.knee.ligaments]
    found = [i for i, x in enumerate(names) if x.startswith(owner)]
    if not found:
        group = next((x.members for x in model.knee.groups if x.name == owner), ())
        found = [i for i, x in enumerate(names) if x in group]
    if not found:
        raise ValueRefused(
            f"a limit of plausibility is about {owner}, and {model.knee.name} has no such ligament",
            f"name one of {', '.join(names[:12])}",
        )
    return tuple(found)


def _residual(limit: Limit, value: float) -> tuple[float, float]:
    """Residual of a limit and its derivative by the value."""
    if limit.form == "normal":
        return (value - limit.size) / limit.spread, 1.0 / limit.spread
    if limit.form == "within":
        beyond = max(abs(value) - limit.size, 0.0) / limit.spread
        return np.sign(value) * beyond, float(beyond > 0.0) / limit.spread
    z = (limit.size - value) / limit.spread
    log_share = float(log_ndtr(z))
    left = float(np.sqrt(-2.0 * log_share))
    if left < NEGLIGIBLE:
        return 0.0, 0.0
    density = np.exp(-0.5 * z * z - HALF_LOG_TWO_PI - log_share)
    return left, float(density / left / limit.spread)


def standard_loads(words: Sequence[str]) -> Protocol:
    """Trials under loads in words, each the name of its trial.

    Raises
    ------
    ValueError
        If one cannot be read.

    Examples
    --------
    >>> made = standard_loads(["134 N anterior, 30 deg", "10 Nm varus + 50 N compression, 0 deg"])
    >>> made.flexion_deg.tolist(), made.loads[1].tolist()
    ([30.0, 0.0], [0.0, 10.0, 0.0, -50.0, 0.0])
    """
    found = [_standard_load(x) for x in words]
    return Protocol(
        name="standard loads",
        trials=tuple(words),
        flexion_deg=np.array([x for x, _ in found]),
        loads=np.array([x for _, x in found]).reshape(len(found), len(LOADS)),
    )


def _standard_load(words: str) -> tuple[float, Array]:
    signs = {
        word: (axis, sign)
        for axis, (one, other, _) in enumerate(WAYS)
        for word, sign in ((one, 1.0), (other, -1.0))
    }
    loads = np.zeros(len(LOADS))
    load, comma, angle = words.rpartition(",")
    flexion = NUMBER.search(angle)
    parts = [] if load.strip() == "unloaded" else load.split("+")
    for part in parts:
        size, named = NUMBER.search(part), [x for x in part.split() if x in signs]
        if size is None or len(named) != 1:
            flexion = None
            break
        axis, sign = signs[named[0]]
        if not {*part[size.end() :].split()[:1]} & {*UNITS_OF_LOADS[WAYS[axis][2]]}:
            flexion = None
            break
        loads[axis] = sign * float(size.group())
    if not comma or flexion is None or not angle.strip().endswith("deg"):
        raise ValueRefused(
            f"the standard load {words!r} cannot be read",
            'write it as in "134 N anterior force + 50 N compression, 30 deg"',
        )
    return float(flexion.group()), loads
