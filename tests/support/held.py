"""Parameters of ligaments that a test holds, and the words that hold them on a command line."""

from collections.abc import Iterable


def both_of(*ligaments: str) -> list[str]:
    """Names of the stiffness and the reference strain of each ligament."""
    return [f"{x}.{y}" for x in ligaments for y in ("stiffness_kN", "reference_strain_pct")]


def fixing(names: Iterable[str]) -> list[str]:
    """The words that hold these parameters."""
    return [word for name in names for word in ("--fix", name)]
