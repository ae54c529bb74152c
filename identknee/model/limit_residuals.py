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
    structure_names,
    tensions_of,
    values_of_structures,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, BoolArray, declared, entry, short_repr
from identknee.runs.errors import ValueRefused
from identknee.subject.menisci import MENISCI
from identknee.subject.plausibility import CONTACT, OTHER_NAMES, TENSION, Limit

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
        The limits. Those for loads that no trial is under are left out, and those of structures of
        the library that the model does not have.
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
    _added: tuple[str, ...] = field(init=False, repr=False)
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
        added = tuple(x for x in structure_names(self.model) if x in OTHER_NAMES)
        used = [
            x
            for x in self.limits
            if (x.load or is_counted[x.trials].any())
            and (x.owner not in OTHER_NAMES or x.owner in added)
        ]
        loads = list(dict.fromkeys(x.load for x in used if x.load))
        standard = self.model.with_protocol(standard_loads(loads)) if loads else None
        made = {
            "limits": tuple(used),
            "_members": tuple(_members(self.model, added, x) for x in used),
            "_added": added,
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
        rows = np.zeros((self.n, theta.size))
        for i, (limit, quantity) in enumerate(
            zip(self.limits, self._quantities(theta), strict=True)
        ):
            value = quantity.value
            by_value = _residual(limit, value)[1] if np.isfinite(value) else 0.0
            # Slopes take longer than a simulation, and few limits are near enough to need them.
            if by_value != 0.0:
                rows[i] = by_value * quantity.slopes
        return rows

    def values(self, theta: Array) -> Array:
        """The limited values: smooth maximum, mean, or value under the standard load, ``(n,)``.

        NaN where none of the trials of a limit has an equilibrium.
        """
        return np.array([x.value for x in self._quantities(theta)])

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

    def _quantities(self, theta: Array) -> list["_Quantity"]:
        """The quantity of each limit at theta."""
        touched = [x for i, x in enumerate(self._counts) if not self._members[i]]
        in_contact = np.flatnonzero(np.any(touched, axis=0)).tolist() if touched else []
        of_trials = _Loads(self.model, theta, self._added, in_contact)
        standard, of_standard, n = self._standard, None, 0
        if standard is not None:
            n = standard.protocol.n
            of_standard = _Loads(standard, theta, self._added, range(n))
        return [
            _Quantity(
                loads=of_standard if limit.load and of_standard is not None else of_trials,
                limit=limit,
                members=members,
                counts=np.arange(n) == at if limit.load else counts,
            )
            for limit, members, counts, at in zip(
                self.limits, self._members, self._counts, self._at, strict=True
            )
        ]

    def _is_standard_lost(self, theta: Array) -> bool:
        standard = self._standard
        return standard is not None and not standard.predict_once(theta).is_converged.all()


class _Loads:
    """Tensions, strains and contact of all trials at one theta, each computed on first use.

    Columns of tensions and strains are those of the ligaments, then of the structures `added`.
    Contact has derivatives in the trials `in_contact`.
    """

    def __init__(
        self, model: LaxityModel, theta: Array, added: Sequence[str], in_contact: Sequence[int]
    ) -> None:
        self.model, self.added, self.in_contact = model, list(added), list(in_contact)
        self.prediction = model.predict_once(theta)

    @cached_property
    def tension(self) -> Array:
        """Tensions [N], shape ``(n, k)``."""
        own = tensions_of(self.model, self.prediction)
        if not self.added:
            return own
        return np.hstack([own, values_of_structures(self.model, self.prediction, self.added)[0]])

    @cached_property
    def strain(self) -> Array:
        """Strains of the ligaments [%], shape ``(n, n_ligaments)``."""
        return strains_of(self.model, self.prediction)

    @cached_property
    def contact(self) -> Array:
        """The whole load of each compartment, through cartilage and meniscus [N], ``(n, 2)``."""
        return compartment_forces(self.prediction)

    @cached_property
    def structures(self) -> StructureLoads:
        """Ligaments and structures with derivatives."""
        return structure_loads(self.model, self.prediction)

    @cached_property
    def tension_slopes(self) -> Array:
        """Derivatives of `tension`, shape ``(n, k, p)``."""
        names = self.structures.names
        columns = [*range(len(self.model.knee.ligaments)), *(names.index(x) for x in self.added)]
        return self.structures.tension_jacobian[:, columns]

    @property
    def strain_slopes(self) -> Array:
        """Derivatives of `strain`, shape ``(n, n_ligaments, p)``."""
        return self.structures.strain_jacobian[:, : len(self.model.knee.ligaments)]

    @cached_property
    def contact_slopes(self) -> Array:
        """Derivatives of `contact`, shape ``(n, 2, p)``; zeros outside `in_contact`."""
        model, made = self.model, self.prediction
        slopes = np.zeros((*self.contact.shape, made.theta.size))
        found = contact_jacobian(model, made, self.in_contact)[:, :, 0]
        if any(x.name == MENISCI for x in model.effects):
            found = found + meniscus_jacobian(model, made, self.in_contact)[:, :, 0]
        slopes[self.in_contact] = found
        return slopes


@dataclass(frozen=True, kw_only=True)
class _Quantity:
    """What a limit is about, from the loads of trials that count.

    Attributes
    ----------
    loads, limit
        The loads and the limit.
    members
        Columns of its ligaments or structures in the loads; none for contact.
    counts
        Whether each trial counts.
    """

    loads: _Loads
    limit: Limit
    members: tuple[int, ...]
    counts: BoolArray

    @property
    def value(self) -> float:
        """Smooth maximum or mean over the trials; NaN where none has an equilibrium."""
        values = self._trials
        if not np.isfinite(values).any():
            return np.nan
        if self.limit.form != "strength":
            return float(values.sum(axis=1).mean())
        soft = SOFTNESS[self.limit.unit]
        return float(soft * np.logaddexp.reduce(values[np.isfinite(values)] / soft))

    @property
    def slopes(self) -> Array:
        """Derivatives of a finite value, shape ``(p,)``."""
        values = self._trials
        slopes = self._of_parts(
            self.loads.contact_slopes
            if not self.members
            else self.loads.tension_slopes
            if self.limit.what.endswith(TENSION)
            else self.loads.strain_slopes
        )
        if self.limit.form != "strength":
            return np.asarray(slopes.sum(axis=1).mean(axis=0))
        is_known = np.isfinite(values)
        known = values[is_known] / SOFTNESS[self.limit.unit]
        return np.asarray(np.exp(known - np.logaddexp.reduce(known)) @ slopes[is_known])

    @cached_property
    def _trials(self) -> Array:
        loads = self.loads
        if not self.members:
            return self._of_parts(loads.contact)
        return self._of_parts(loads.tension if self.limit.what.endswith(TENSION) else loads.strain)

    def _of_parts(self, whole: Array) -> Array:
        """Of trials that count and have an equilibrium: force or sum of tensions, each strain."""
        used = whole[self.counts & self.loads.prediction.is_converged]
        if self.members:
            own = used[:, self.members]
            is_sum = self.limit.what.endswith(TENSION)
            return np.nan_to_num(own).sum(axis=1, keepdims=True) if is_sum else own
        side, *less = (_side(x) for x in (self.limit.what, self.limit.less) if x)
        found = used[:, side, None]
        return np.asarray(found - used[:, less] if less else found)


def _side(what: str) -> int:
    """Index of the compartment in a name such as ``"contact.medial_N"``."""
    return COMPARTMENTS.index(what.removeprefix(f"{CONTACT}.").partition("_")[0])


def _members(model: LaxityModel, added: Sequence[str], limit: Limit) -> tuple[int, ...]:
    """Columns of the ligaments or added structures of a limit; none for contact."""
    names, owner = [x.name for x in model.knee.ligaments], limit.owner
    if owner == CONTACT:
        return ()
    if owner in added:
        return (len(names) + added.index(owner),)
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
