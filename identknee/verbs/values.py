"""Numbers with names and units, given as numbers or as they are typed on a command line."""

import math
from collections.abc import Mapping, Sequence, Sized
from numbers import Real
from typing import Any, cast

from identknee.laxity.noise import noise_sizes
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity
from identknee.runs.declare import OF_COORDINATE, Array, array, declared, entry

STIFFNESS, LARGEST_STIFFNESS_KN = ".stiffness_kN", 1000.0


NoiseLike = str | float | tuple[float, float] | None
DiscrepancyLike = str | float | tuple[float, float]
# Scales of the prior of a smooth error of the model [mm, deg]: an estimate.
SMOOTH = (1.0, 2.0)
STRUCTURES = "structures"
ValuesLike = Sequence[str] | Mapping[str, float] | None
BoundsLike = Sequence[str] | Mapping[str, tuple[float, float]] | None


def noise_of(noise: str | float | tuple[float, float]) -> tuple[float, float]:
    """Standard deviations of lengths and angles [mm, deg], however they were given.

    One number stands for both.

    Raises
    ------
    ValueError
        If they are no sizes of noise.
    """
    if isinstance(noise, str):
        return noise_sizes(noise)
    given: Any = noise
    is_truth: bool = isinstance(given, bool)
    if isinstance(given, Real) and not is_truth:
        given = (float(given), float(given))
    if isinstance(given, Mapping) and set(given) == {"mm", "deg"}:
        given = (given["mm"], given["deg"])
    if isinstance(given, Mapping) or not isinstance(given, Sized) or len(given) != 2:
        raise ValueError(
            f"noise {noise}: these are not two sizes. Give the standard deviations of translations "
            "[mm] and of rotations [deg], for example (0.3, 0.3)"
        )
    mm, deg = cast("tuple[float, float]", given)
    return noise_sizes(f"{mm}mm,{deg}deg")


def discrepancy_of(discrepancy: DiscrepancyLike) -> tuple[float, float] | None:
    """Scales of the prior of a smooth error of the model [mm, deg]; None for none.

    Structures that the model lacks are no such error: they are nuisances of the knee.

    Raises
    ------
    ValueError
        If they are no such sizes.
    """
    if discrepancy in ("none", STRUCTURES):
        return None
    if discrepancy == "smooth":
        return SMOOTH
    try:
        return noise_of(discrepancy)
    except ValueError:
        raise ValueError(
            f"discrepancy {discrepancy}: give none, structures, smooth, or the scales of its prior "
            "in mm and deg, for example 0.5mm,1deg"
        ) from None


def noise_words(noise: NoiseLike) -> str | None:
    """Sizes of noise as they are typed, however they were given; None for None.

    Examples
    --------
    >>> noise_words(0.3), noise_words((0.5, 1))
    ('0.3mm,0.3deg', '0.5mm,1.0deg')
    """
    if noise is None or isinstance(noise, str):
        return noise
    mm, deg = noise_of(noise)
    return f"{mm}mm,{deg}deg"


def values_of(values: ValuesLike) -> dict[str, float]:
    """Values by parameter name, however they were given.

    Raises
    ------
    ValueError
        If a text has another form, a name comes twice, or a stiffness is so large that its unit
        must be N.

    Examples
    --------
    >>> values_of(["ACL.stiffness_kN=9.5"])
    {'ACL.stiffness_kN': 9.5}
    """
    if isinstance(values, Mapping):
        found = {name: float(value) for name, value in values.items()}
    else:
        stated = _by_name(values or [], "--set", "ACL.stiffness_kN=9.5")
        found = {name: _number(value, f"--set {text}") for name, (value, text) in stated.items()}
    for name, value in found.items():
        _check_stiffness(f"--set {name}={value:g}", name, value)
    return found


def by_ligament(values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Values by parameter name as ligament, then quantity.

    Examples
    --------
    >>> by_ligament({"ACL.stiffness_kN": 10.0, "ACL.reference_strain_pct": 8.0})
    {'ACL': {'stiffness_kN': 10.0, 'reference_strain_pct': 8.0}}
    """
    tree: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        owner, _, quantity = name.rpartition(".")
        tree.setdefault(owner, {})[quantity] = float(value)
    return tree


def bounds_of(bounds: BoundsLike) -> dict[str, tuple[float, float]]:
    """Lower and upper bound by parameter name, however they were given.

    Raises
    ------
    ValueError
        If a text has another form or a name comes twice.

    Examples
    --------
    >>> bounds_of(["ACL.stiffness_kN=5:15"])
    {'ACL.stiffness_kN': (5.0, 15.0)}
    """
    if isinstance(bounds, Mapping):
        pairs = {name: _pair(name, given) for name, given in bounds.items()}
        for name, pair in pairs.items():
            _check_stiffness(f"bounds of {name}", name, pair[0])
        return pairs
    found = {}
    for name, (value, text) in _by_name(bounds or [], "--bounds", "ACL.stiffness_kN=5:15").items():
        where, (low, colon, high) = f"--bounds {text}", value.partition(":")
        if not colon:
            raise ValueError(
                f"{where}: there is no upper bound. "
                f"Write LOWER:UPPER, for example --bounds {name}=5:15"
            )
        found[name] = (_number(low, where), _number(high, where))
        _check_stiffness(where, name, found[name][0])
    return found


def _check_stiffness(where: str, name: str, value: float) -> None:
    """Refuse a stiffness, or a lower bound of one, that is most likely in N per unit strain."""
    if name.endswith(STIFFNESS) and value > LARGEST_STIFFNESS_KN:
        raise ValueError(
            f"{where}: no ligament has a stiffness of {value:g} kN per unit strain. If this is N "
            "per unit strain, divide it by 1000"
        )


def _pair(name: str, given: object) -> tuple[float, float]:
    """Lower and upper bound of a parameter."""
    ends = given.split(":") if isinstance(given, str) else given
    try:
        low, high = (float(x) for x in cast("Sequence[float]", ends))
    except (TypeError, ValueError):
        raise ValueError(
            f"bounds of {name}: {given!r} is no pair of numbers. Write for example "
            f"bounds={{'{name}': (5, 15)}}"
        ) from None
    return low, high


def _by_name(texts: Sequence[str], option: str, example: str) -> dict[str, tuple[str, str]]:
    """What each text ``NAME=VALUE`` states, by its name, and the text itself."""
    found: dict[str, tuple[str, str]] = {}
    for text in texts:
        name, equals, value = (x.strip() for x in text.partition("="))
        if not equals or not name:
            raise ValueError(
                f"{option} {text}: this is not NAME=VALUE. Write for example {option} {example}"
            )
        if name in found:
            raise ValueError(f"{option} gives {name} twice; give it once.")
        found[name] = value, text
    return found


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{where}: {text.strip()!r} is not a number. Write a number such as 9.5")
    return value


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
