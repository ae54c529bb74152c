"""Ligaments whose parameters are tied: the bundles of one anatomical ligament."""

from collections.abc import Sequence
from dataclasses import dataclass

from identknee.runs.errors import suggestion
from identknee.subject.ligament import Ligament

LEAST = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LigamentGroup:
    """Bundles with one stiffness scale and one shift of their strains; their pattern is kept.

    Attributes
    ----------
    name
        What the ligament is called; its parameters are named ``NAME.stiffness_kN``, the sum of its
        members', and ``NAME.reference_strain_pct``, their mean weighted by stiffness.
    members
        Names of the bundles.

    Raises
    ------
    ValueError
        If there are fewer than two members, or one is named twice.
    """

    name: str
    members: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        if len(self.members) < LEAST or len(set(self.members)) < len(self.members):
            raise ValueError(
                f"the group {self.name} must name two or more ligaments, each once; got "
                f"{', '.join(self.members) or 'none'}"
            )


def check_groups(groups: Sequence[LigamentGroup], ligaments: Sequence[Ligament]) -> None:
    """Refuse groups that the ligaments do not allow.

    Raises
    ------
    ValueError
        If a member is no ligament or in two groups, no member of a group has a stiffness, or a
        group is called as a ligament or another group is.
    """
    stiffness = {x.name: x.stiffness_kN for x in ligaments}
    seen: set[str] = set()
    taken = set(stiffness)
    for group in groups:
        if group.name in taken:
            raise ValueError(
                f"the group {group.name} is called as a ligament or another group is; rename it"
            )
        taken.add(group.name)
        for member in group.members:
            if member not in stiffness:
                raise ValueError(
                    f"the group {group.name} names the ligament {member!r}, which the knee does "
                    f"not have. {suggestion(member, list(stiffness))}"
                )
            if member in seen:
                raise ValueError(f"the ligament {member} is in two groups; leave it in one of them")
            seen.add(member)
        if not sum(stiffness[x] for x in group.members) > 0.0:
            raise ValueError(
                f"no ligament of the group {group.name} has a stiffness above 0; give one to its "
                "members, whose shares are kept"
            )
