"""The joint capsule as sheets of lines: a part of a knee like its ligaments.

A sheet is a group of three lines with one stiffness and one reference strain, placed by anatomy.
Its values are those of isolated specimens and its priors are wide; where insertions lie is an
estimate (`identknee.subject.insertion_sites`).

References
----------
.. [1] Robinson et al. (2005), J. Biomech. 38(5), 1067-1074.
       https://doi.org/10.1016/j.jbiomech.2004.05.034
.. [2] Zens et al. (2015), J. Exp. Orthop. 2, 7. https://doi.org/10.1186/s40634-015-0023-3
.. [3] Helito et al. (2016), BMC Musculoskelet. Disord. 17, 193.
       https://doi.org/10.1186/s12891-016-1052-5
.. [4] Shin et al. (2007), J. Biomech. 40(5), 1145-1152.
       https://doi.org/10.1016/j.jbiomech.2006.05.004
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from identknee.runs.declare import declared, entry
from identknee.runs.errors import ValueRefused, suggestion
from identknee.subject.insertion_sites import capsule_sites
from identknee.subject.knee import Knee, StatedPrior
from identknee.subject.ligament import Ligament, LigamentGroup


@declared
class Sheet:
    """A sheet of the capsule: the name of its group, and its stiffness before any test."""

    group: str = entry("Name of the group of its lines")
    stiffness_kN: float = entry("Stiffness of the whole sheet", unit="kN")  # noqa: N815 - the unit
    source: str = entry("Where the stiffness comes from")


# Strain in the scanned pose, near extension [%], an estimate; and standard deviations of the
# priors: of the logarithm of the stiffness, and of the strain [%].
REFERENCE_STRAIN, LOG_STIFFNESS_SD, STRAIN_SD = 1.5, 0.7, 4.0
SHEETS: Mapping[str, Sheet] = MappingProxyType(
    {
        "posteromedial": Sheet(
            group="PMC", stiffness_kN=2.0, source="the middle of 1 to 3 kN, 56 +- 20 N/mm [1]_"
        ),
        "posterolateral": Sheet(
            group="PLC", stiffness_kN=1.0, source="the posterior capsule of published models [4]_"
        ),
        "anterolateral": Sheet(
            group="ALC",
            stiffness_kN=0.44,
            source="the geometric mean of 0.14 kN [2]_ and 1.4 kN [3]_",
        ),
    }
)


def with_capsule(knee: Knee, sheets: Sequence[str] = tuple(SHEETS)) -> Knee:
    """The knee with sheets of the capsule among its ligaments.

    All verbs treat them like other groups: parameters such as ``PMC.stiffness_kN``, forces, cuts
    (``cut: PMC``) and uncertain insertions.

    Parameters
    ----------
    knee
        The subject.
    sheets
        Which sheets, of `SHEETS`.

    Raises
    ------
    ValueError
        If there is no such sheet, the knee has a ligament or group of its name, or the femoral
        surface has no posterior condyle on one side.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> knee = with_capsule(reference_knee(), ["posteromedial"])
    >>> [x.name for x in knee.ligaments], [x.name for x in knee.groups]
    (['ACL', 'PCL', 'LCL', 'MCL', 'PMC1', 'PMC2', 'PMC3'], ['PMC'])
    """
    for name in sheets:
        if name not in SHEETS:
            raise ValueRefused(
                f"the capsule has no sheet {name!r}", suggestion(name, list(SHEETS)).rstrip(".")
            )
    sites = capsule_sites(knee) if sheets else {}
    taken = {x.name for x in knee.ligaments} | {x.name for x in knee.groups}
    ligaments, groups, priors = list(knee.ligaments), list(knee.groups), dict(knee.priors)
    for name in dict.fromkeys(sheets):
        sheet = SHEETS[name]
        members = tuple(f"{sheet.group}{i + 1}" for i in range(len(sites[name])))
        if clash := taken & {sheet.group, *members}:
            raise ValueRefused(
                f"{knee.name} has a ligament or group called {min(clash)}",
                f"rename it, or leave out the sheet {name} of the capsule",
            )
        ligaments += [
            Ligament(
                name=member,
                femur=site.femur,
                tibia=site.tibia,
                stiffness_kN=sheet.stiffness_kN / len(members),
                reference_strain_pct=REFERENCE_STRAIN,
            )
            for member, site in zip(members, sites[name], strict=True)
        ]
        groups.append(LigamentGroup(name=sheet.group, members=members))
        stated = {
            f"{sheet.group}.stiffness_kN": StatedPrior(log_sd=LOG_STIFFNESS_SD),
            f"{sheet.group}.reference_strain_pct": StatedPrior(sd=STRAIN_SD),
        }
        priors = {**stated, **priors}
    return replace(knee, ligaments=tuple(ligaments), groups=tuple(groups), priors=priors, fitted={})
