"""Trials and their coordinates by kind of load."""

from identknee.laxity.dominant import DIRECTIONS
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

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> laxity_groups(load_protocol("seed63"))[3]
    'varus_deg, 0 deg, valgus moment'
    """
    scenarios = load_scenarios(protocol)
    return tuple(
        SEPARATOR.join((coordinate, f"{flexion:g} deg", scenario))
        for flexion, scenario in zip(protocol.flexion_deg, scenarios, strict=True)
        for coordinate in COORDINATES
    )
