"""Whether missing structures run where they do in a knee."""

from dataclasses import replace

import numpy as np
import pytest
from data_files import stored
from posed_knees import posed_reference

from identknee.mechanics.closest_point import mesh_distance
from identknee.runs.declare import Array
from identknee.subject.anatomy import anatomy
from identknee.subject.folder import example
from identknee.subject.insertion_sites import Site, structure_sites
from identknee.subject.knee import Knee

# Lengths [mm] at a knee of typical size.
LENGTHS = {
    "anterolateral": (25.0, 55.0),
    "posteromedial": (25.0, 60.0),
    "popliteofibular": (10.0, 45.0),
    "deep_mcl": (15.0, 40.0),
    "posterior_capsule": (25.0, 70.0),
}
# As deep as a line may run through the femur [mm], and what nearest triangles tell wrong of it.
DEEPEST = 3.0
ROUGH = 0.1
# How far from where they were segmented in a real knee [mm]: the posteromedial structure and the
# upper end of the capsule are placed by other sources than that knee.
SEGMENTED = {"deep_mcl": 6.0, "popliteofibular": 7.0, "posteromedial": 15.0}
# Every site lies further than this to its side of the middle of the tibia [mm].
INSIDE = 10.0
GROUPS = {"deep_mcl": "MCLd", "popliteofibular": "PFL", "posteromedial": "MCLp"}


def lines(knee: Knee) -> list[tuple[str, Site]]:
    return [(name, x) for name, sites in structure_sites(knee).items() for x in sites]


def along(site: Site) -> Array:
    share = np.linspace(0.0, 1.0, 101)[:, None]
    points: Array = (1.0 - share) * site.femur + share * site.tibia
    return points


def check(knee: Knee) -> None:
    """Lengths, sides and depths in the femur."""
    found = anatomy(knee)
    distance = mesh_distance(knee.femur.vertices, knee.femur.faces)
    middle = 0.5 * (found.medial.plateau_centre + found.lateral.plateau_centre)
    for name, site in lines(knee):
        shortest, longest = LENGTHS[name]
        assert shortest < site.length / found.size < longest, site.name
        outward = knee.tibia_frame.axes[2] * (1.0 if site.side == "lateral" else -1.0)
        assert (((site.femur, site.tibia) - middle) @ outward > INSIDE * found.size).all()
        assert -distance(along(site)).min() < (DEEPEST + ROUGH) * found.size, site.name
        assert (site.femur - site.tibia) @ knee.tibia_frame.axes[1] > 0.0


def test_sites_of_the_reference_knee(reference: Knee) -> None:
    check(reference)
    assert {name for name, _ in lines(reference)} == set(LENGTHS)
    names = [x.name for _, x in lines(reference)]
    assert len(set(names)) == len(names) == 6


def test_sites_without_collaterals(reference: Knee) -> None:
    check(reference.with_ligaments([]))
    check(reference.with_ligaments([x for x in reference.ligaments if x.name != "LCL"]))


def test_sites_of_a_renamed_knee_elsewhere() -> None:
    knee = posed_reference(3)
    check(knee)
    # What a structure is placed by is not moved by another like it.
    fewer = knee.with_ligaments(knee.ligaments[:4])
    for (_, one), (_, other) in zip(lines(knee), lines(fewer), strict=True):
        np.testing.assert_array_equal(one.femur, other.femur)


@pytest.mark.parametrize("name", ["lenhart2015_stable", "lenhart2015"])
def test_sites_of_real_knees(name: str) -> None:
    check(example(name))


def test_sites_lie_where_the_ligaments_of_a_real_knee_were_segmented() -> None:
    bundles = stored("lenhart2015.json")["bundles"]
    sites = structure_sites(example("lenhart2015"))
    for name, limit in SEGMENTED.items():
        (site,) = sites[name]
        for bone in ("femur", "tibia"):
            there = np.mean(
                [x[f"{bone}_mm"] for x in bundles if x["group"] == GROUPS[name]], axis=0
            )
            assert np.linalg.norm(getattr(site, bone) - there) < limit, (name, bone)
    for site in sites["posterior_capsule"]:
        sign = 1.0 if site.side == "lateral" else -1.0
        own = [x["tibia_mm"] for x in bundles if x["group"] == "pCAP"]
        there = np.mean([x for x in own if sign * x[2] > 0.0], axis=0)
        assert np.linalg.norm(site.tibia - there) < 5.0


def test_a_line_through_a_condyle_is_moved_outward(reference: Knee) -> None:
    lcl = reference.ligament("LCL")
    # Within the condyle, whose surface reaches to 40 mm.
    inward = replace(lcl, femur=lcl.femur * [1.0, 1.0, 0.0] + [0.0, 0.0, 33.0])
    others = [x for x in reference.ligaments if x.name != "LCL"]
    knee = reference.with_ligaments([*others, inward])
    assert knee.femur_distance is not None
    (site,) = structure_sites(knee)["anterolateral"]
    assert site.femur[2] > inward.femur[2] + 1.0
    unmoved = replace(site, femur=site.femur * [1.0, 1.0, 0.0] + [0.0, 0.0, 33.0])
    deepest = DEEPEST * anatomy(knee).size
    assert -knee.femur_distance(along(unmoved)).min() > deepest + 1.0
    assert deepest - 0.5 < -knee.femur_distance(along(site)).min() < deepest + ROUGH


def test_the_anterolateral_line_crosses_the_lateral_collateral(reference: Knee) -> None:
    (site,) = structure_sites(reference)["anterolateral"]
    lcl = reference.ligament("LCL")
    assert site.femur[0] < lcl.femur[0]
    assert lcl.tibia[0] < site.tibia[0] < anatomy(reference).lateral.anterior_margin[0]
    assert site.tibia[1] > lcl.tibia[1]
