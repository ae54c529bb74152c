"""Measured laxity as an answer keeps it, and trials that an answer advises."""

from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_COORDINATE, array, declared, entry

OF_LOAD = "N or N·m, as the load's name says"


@declared
class AdvisedTrial:
    """A trial to make."""

    trial: str = entry("Its name")
    flexion_deg: float = entry("Flexion", unit="deg")
    internal_moment_Nm: float = entry("Internal moment", unit="N m", default=0.0)  # noqa: N815
    varus_moment_Nm: float = entry("Varus moment", unit="N m", default=0.0)  # noqa: N815
    anterior_force_N: float = entry("Anterior force", unit="N", default=0.0)  # noqa: N815
    distraction_force_N: float = entry("Distraction force", unit="N", default=0.0)  # noqa: N815
    lateral_force_N: float = entry("Lateral force", unit="N", default=0.0)  # noqa: N815


def advised(protocol: Protocol) -> tuple[AdvisedTrial, ...]:
    """The trials of a protocol, one by one."""
    rows = zip(protocol.trials, protocol.flexion_deg, protocol.loads.tolist(), strict=True)
    return tuple(
        AdvisedTrial(trial=name, flexion_deg=float(angle), **dict(zip(LOADS, loads, strict=True)))
        for name, angle, loads in rows
    )


@declared
class Trials:
    """Measured laxity."""

    protocol_name: str = entry("Name of the protocol")
    zero: str = entry("What coordinates are counted from: absolute or unloaded")
    names: tuple[str, ...] = array("Names of the trials", "trial", is_in_arrays=False)
    load_names: tuple[str, ...] = array("Names of the loads", "load", is_in_arrays=False)
    coordinate_names: tuple[str, ...] = array(
        "Names of the coordinates", "coordinate", is_in_arrays=False
    )
    flexion_deg: Array = array("Flexion of each trial", "trial", unit="deg")
    loads: Array = array("Loads of each trial", "trial", "load", unit=OF_LOAD)
    coordinates: Array = array("Measured laxity", "trial", "coordinate", unit=OF_COORDINATE)
    sd: Array | None = array(
        "Stated noise", "trial", "coordinate", unit=OF_COORDINATE, default=None
    )

    def __post_init__(self) -> None:
        if self.coordinate_names != COORDINATES or self.load_names != LOADS:
            raise ValueError("the loads or coordinates are not those of a laxity table")
        # Refuses trials that are none.
        _ = self.protocol

    @property
    def protocol(self) -> Protocol:
        """The trials as they were loaded."""
        return Protocol(
            name=self.protocol_name,
            trials=self.names,
            flexion_deg=self.flexion_deg,
            loads=self.loads,
        )


def trials_of(laxity: Laxity) -> Trials:
    """Measured laxity as an answer keeps it."""
    protocol = laxity.protocol
    return Trials(
        protocol_name=protocol.name,
        zero=laxity.zero,
        names=protocol.trials,
        load_names=LOADS,
        coordinate_names=COORDINATES,
        flexion_deg=protocol.flexion_deg,
        loads=protocol.loads,
        coordinates=laxity.coordinates,
        sd=laxity.sd,
    )
