"""Trials and loads in words."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from identknee.laxity.experiments import INTACT
from identknee.laxity.protocol import (
    DIRECTIONS,
    FLEXION,
    LOADS,
    Protocol,
    dominant_loads,
    nominal_flexion,
    nominal_loads,
)
from identknee.laxity.table import COORDINATES
from identknee.runs.declare import Array, declared, derived, entry
from identknee.runs.words import listed, unit_of

UNLOADED = "unloaded"
# Pulling and pressing are named without the word force where they stand by themselves.
SHORT_DIRECTIONS = (*DIRECTIONS[:3], ("distraction", "compression"), *DIRECTIONS[4:])


def load_word(axis: int, value: float, pattern: str, *, is_short: bool = False) -> str:
    """One load in words.

    Parameters
    ----------
    axis
        Its place among the loads.
    value
        Its size with its sign [N or N m].
    pattern
        With the fields ``what``, ``size`` and ``unit``.
    is_short
        Whether the axial force is called distraction or compression alone.

    Examples
    --------
    >>> load_word(1, -4.0, "{size:g} {unit} of {what}")
    '4 N·m of valgus moment'
    """
    what = (SHORT_DIRECTIONS if is_short else DIRECTIONS)[axis][0 if value > 0.0 else 1]
    return pattern.format(what=what, size=abs(value), unit=load_unit(axis))


def load_unit(axis: int) -> str:
    """Unit of a load."""
    return unit_of(LOADS[axis])


def load_label(axis: int) -> str:
    """A load with its unit in brackets, for an axis.

    Examples
    --------
    >>> load_label(0)
    'internal moment [N·m]'
    """
    return f"{DIRECTIONS[axis][0]} [{load_unit(axis)}]"


def loads_words(
    loads: Sequence[float] | Array, pattern: str, *, is_short: bool = False
) -> list[str]:
    """The loads of a trial that are not zero, each as `load_word` says it."""
    return [load_word(i, x, pattern, is_short=is_short) for i, x in enumerate(loads) if x != 0.0]


def load_words(protocol: Protocol, trial: int) -> str:
    """The load that a trial is about, in words.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> load_words(load_protocol("drawer"), 0), load_words(load_protocol("drawer"), 1)
    ('100 N of posterior force at 0 deg', 'no load at 0 deg')
    """
    found = dominant_loads(protocol)
    axis, angle = int(found.axis[trial]), f"at {protocol.flexion_deg[trial]:.0f} deg"
    if axis < 0:
        return f"no load {angle}"
    acting = abs(protocol.loads[trial, axis])
    signed = acting if found.size[trial] > 0.0 else -acting
    return f"{load_word(axis, signed, '{size:.3g} {unit} of {what}')} {angle}"


def setting_words(flexion_deg: float, loads: Sequence[float] | Array) -> str:
    """Flexion and loads of a trial, as the caption of a picture; loads of shape ``(5,)``.

    Examples
    --------
    >>> setting_words(30.0, [0.0, -4.0, 0.0, 0.0, 0.0])
    'Flexion 30°, valgus moment 4 N·m'
    """
    parts = loads_words(loads, "{what} {size:.4g} {unit}", is_short=True)
    return f"Flexion {round(flexion_deg, 1):g}°, {' and '.join(parts) or UNLOADED}"


def trial_description(trial: Mapping[str, Any]) -> str:
    """A trial to do, from its angle, its loads and its state where something is cut.

    Examples
    --------
    >>> trial_description({"flexion_deg": 30.0, "anterior_force_N": -134.0})
    'posterior force of 134 N at 30 deg of flexion'
    >>> trial_description({"flexion_deg": 30.0, "state": "cut: ACL"})
    'no load at 30 deg of flexion (cut: ACL)'
    """
    values = [float(trial.get(name) or 0.0) for name in LOADS]
    loads = listed(loads_words(values, "{what} of {size:g} {unit}", is_short=True))
    state = trial.get("state", INTACT)
    made_in = "" if state == INTACT else f" ({state})"
    return f"{loads or 'no load'} at {float(trial[FLEXION]):g} deg of flexion{made_in}"


def load_scenarios(protocol: Protocol) -> tuple[str, ...]:
    """What loads each trial, for example ``"valgus moment"``; ``"unloaded"`` where nothing does.

    Where a ligament is cut the state follows: ``"valgus moment, cut: ACL"``.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> load_scenarios(load_protocol("drawer"))[:3]
    ('posterior force', 'unloaded', 'anterior force')
    """
    loads = (" + ".join(loads_words(x, "{what}")) or UNLOADED for x in protocol.loads)
    return tuple(
        x if state == INTACT else f"{x}, {state}"
        for x, state in zip(loads, protocol.states, strict=True)
    )


def series_words(protocol: Protocol, trial: int) -> tuple[str, ...]:
    """Experiment and state of a trial; empty where all trials are of one."""
    if not protocol.series.any():
        return ()
    return tuple(x[trial] for x in (protocol.experiment, protocol.state) if x is not None)


@declared
class LaxityGroup:
    """Outputs of one kind: a coordinate at a flexion angle under a kind of load."""

    coordinate: str = entry("Name of the coordinate")
    flexion_deg: float = entry("Nominal flexion", unit="deg")
    load: str = entry("Kind of load; unloaded for none")

    @property
    @derived("Name of the group")
    def name(self) -> str:
        """Name of the group, such as ``"varus_deg, 0 deg, valgus moment"``."""
        return f"{self.coordinate}, {self.place}"

    @property
    def place(self) -> str:
        """Flexion angle and load."""
        return f"{self.flexion_deg:g} deg, {self.load}"


def laxity_groups(protocol: Protocol) -> tuple[LaxityGroup, ...]:
    """Group of every coordinate of every trial: coordinate, flexion angle and kind of load.

    Where a rig reads its own angle in each trial, angles close together are one. Stray loads are
    left out, and a load that all trials hold.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> laxity_groups(load_protocol("seed63"))[3].name
    'varus_deg, 0 deg, valgus moment'
    """
    scenarios = load_scenarios(replace(protocol, loads=nominal_loads(protocol)))
    return tuple(
        LaxityGroup(coordinate=coordinate, flexion_deg=float(flexion), load=scenario)
        for flexion, scenario in zip(nominal_flexion(protocol), scenarios, strict=True)
        for coordinate in COORDINATES
    )
