"""The reference knee with an MCL of two bundles, which are a group."""

from dataclasses import replace

import identknee as ik
from identknee.subject.ligament import LigamentGroup


def bundled_knee() -> ik.Knee:
    """Its MCL has half its stiffness in each of two bundles, one of them 4 mm behind the other."""
    knee = ik.reference_knee()
    whole = next(x for x in knee.ligaments if x.name == "MCL")
    half = replace(whole, stiffness_kN=whole.stiffness_kN / 2.0)
    others = [x for x in knee.ligaments if x.name != "MCL"]
    behind = half.tibia - [4.0, 0.0, 0.0]
    bundles = [replace(half, name="MCLa"), replace(half, name="MCLp", tibia=behind)]
    group = LigamentGroup(name="MCL", members=("MCLa", "MCLp"))
    return replace(knee, ligaments=(*others, *bundles), groups=(group,))
