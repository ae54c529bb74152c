"""Trials and their coordinates by kind of load."""

from dataclasses import replace

from identknee.laxity.dominant import DIRECTIONS, nominal_flexion, told_loads
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES
from identknee.runs.declare import declared, derived, entry

UNLOADED = "unloaded"


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
    scenarios = load_scenarios(replace(protocol, loads=told_loads(protocol)))
    return tuple(
        LaxityGroup(coordinate=coordinate, flexion_deg=float(flexion), load=scenario)
        for flexion, scenario in zip(nominal_flexion(protocol), scenarios, strict=True)
        for coordinate in COORDINATES
    )
