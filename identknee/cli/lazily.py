"""What several verbs share and what takes long to load."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import identknee as ik


def warm_up(knee: "ik.Knee", protocol: "ik.Protocol") -> None:
    """As `identknee.verbs.identification.warm_up`."""
    from identknee.verbs import identification

    identification.warm_up(knee, protocol)


def knee_digest(knee: "ik.Knee") -> str:
    """As `identknee.verbs.knee_digest.knee_digest`."""
    from identknee.verbs import knee_digest

    return knee_digest.knee_digest(knee)
