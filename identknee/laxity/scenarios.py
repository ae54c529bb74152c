"""Trials and their coordinates by kind of load."""

from dataclasses import replace

from identknee.laxity.dominant import DIRECTIONS, nominal_flexion, told_loads
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES

UNLOADED = "unloaded"
SEPARATOR = ", "


def load_scenarios(protocol: Protocol) -> tuple[str, ...]:
    """What loads each trial, for example ``"valgus moment"``; ``"unloaded"`` where nothing does.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> load_scenarios(load_protocol("drawer"))[:3]
    ('posterior force', 'unloaded', 'anterior force')
    """
    return tuple(
        " + ".join(
            DIRECTIONS[i][0 if loads[i] > 0 else 1] for i in range(len(LOADS)) if loads[i] != 0.0
        )
        or UNLOADED
        for loads in protocol.loads
    )


def laxity_groups(protocol: Protocol) -> tuple[str, ...]:
    """Group of every coordinate of every trial: coordinate, flexion angle and kind of load.

    Where a rig reads its own angle in each trial, angles close together are one. Stray loads are
    left out, and a load that all trials hold.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> laxity_groups(load_protocol("seed63"))[3]
    'varus_deg, 0 deg, valgus moment'
    """
    scenarios = load_scenarios(replace(protocol, loads=told_loads(protocol)))
    return tuple(
        SEPARATOR.join((coordinate, f"{flexion:g} deg", scenario))
        for flexion, scenario in zip(nominal_flexion(protocol), scenarios, strict=True)
        for coordinate in COORDINATES
    )
