"""What lines of action are called."""

import numpy as np
import pytest
from posed_knees import posed_reference

from identknee.subject.anatomy import anatomy
from identknee.subject.insertion_sites import ELSEWHERE, Place, Site, name_of_place, structure_sites
from identknee.subject.knee import Knee

# Shares below 1 % are left out.
LEFT_OUT = 0.06


def place_of(knee: Knee, site: Site) -> Place:
    return name_of_place(knee, site.femur, site.tibia)


def test_every_structure_and_ligament_is_called_by_its_name(reference: Knee) -> None:
    for name, sites in structure_sites(reference).items():
        for site in sites:
            place = place_of(reference, site)
            assert place.shares[0][0] == name
            assert place.sides == ((site.side, 1.0),)
            assert 1.0 - LEFT_OUT < sum(x for _, x in place.shares) <= 1.0 + 1e-12
    for line in reference.ligaments:
        assert name_of_place(reference, line.femur, line.tibia).shares[0][0] == line.name


def test_thirds_of_the_plateaus(reference: Knee) -> None:
    sites = structure_sites(reference)
    (capsule, _), (deep,) = sites["posterior_capsule"], sites["deep_mcl"]
    assert place_of(reference, capsule).thirds[0][0] == "posterior"
    assert place_of(reference, deep).thirds[0][0] == "middle"
    acl = reference.ligament("ACL")
    place = name_of_place(reference, acl.femur, acl.tibia)
    assert place.sides[0][0] == "central"
    assert place.thirds[0][0] == "anterior"
    where, _, shares = place.sentence.partition(": ")
    assert where.startswith("anterior ")
    assert where.endswith(" central")
    assert shares.startswith("ACL 0.9")


def test_a_line_slid_along_itself_keeps_its_names(reference: Knee) -> None:
    (site,) = structure_sites(reference)["anterolateral"]
    along = 0.2 * (site.femur - site.tibia)
    slid = name_of_place(reference, site.femur + along, site.tibia + along)
    there = dict(place_of(reference, site).shares)
    assert dict(slid.shares) == pytest.approx(there, abs=1e-12)


def test_far_from_everything_it_is_elsewhere(reference: Knee) -> None:
    place = name_of_place(reference, [60.0, 10.0, 0.0], [60.0, -60.0, 0.0])
    assert dict(place.shares)[ELSEWHERE] > 0.99


def test_a_cloud_of_lines_shares_its_names(reference: Knee) -> None:
    sites = structure_sites(reference)
    (one,), (other,) = sites["anterolateral"], sites["deep_mcl"]
    cloud = name_of_place(
        reference, [one.femur, one.femur, other.femur], [one.tibia, one.tibia, other.tibia]
    )
    assert dict(cloud.sides) == pytest.approx({"lateral": 2 / 3, "medial": 1 / 3})
    single = dict(place_of(reference, one).shares)["anterolateral"]
    assert dict(cloud.shares)["anterolateral"] == pytest.approx(2 / 3 * single)


def test_names_move_with_the_knee() -> None:
    knee = posed_reference(4)
    still = posed_reference(is_moved=False, scale=1.0)
    for (_, sites), (_, unmoved) in zip(
        structure_sites(knee).items(), structure_sites(still).items(), strict=True
    ):
        for here, there in zip(sites, unmoved, strict=True):
            one, other = place_of(knee, here), place_of(still, there)
            assert dict(one.shares) == pytest.approx(dict(other.shares), abs=1e-6)
            assert (one.sides, one.thirds) == (other.sides, other.thirds)


def test_an_own_line_like_a_structure_shares_with_it() -> None:
    knee = posed_reference()
    line = knee.ligament("oblique")
    shares = dict(name_of_place(knee, line.femur, line.tibia).shares)
    assert shares["oblique"] > shares["anterolateral"] > 0.2


def test_a_level_line_is_placed_where_it_lies(reference: Knee) -> None:
    level = anatomy(reference).joint_line + 5.0
    place = name_of_place(reference, [-15.0, level, 30.0], [15.0, level, 30.0])
    assert place.sides == (("lateral", 1.0),)


def test_two_equal_points_are_no_line(reference: Knee) -> None:
    with pytest.raises(ValueError, match="different points"):
        name_of_place(reference, np.zeros(3), np.zeros(3))
