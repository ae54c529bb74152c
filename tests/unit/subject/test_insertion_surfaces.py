"""The points between which lines of action are sought."""

import numpy as np
import pytest
from posed_knees import posed_reference
from scipy.spatial import cKDTree

from identknee.runs.declare import Array
from identknee.subject.folder import example
from identknee.subject.insertion_sites import InsertionPoints, insertion_surfaces, structure_sites
from identknee.subject.knee import Knee

# How far a place of interest may lie from the nearest point [mm]; points are 7 mm apart.
REACHED = 6.0
FEWEST, MOST = 150, 250


def shell(points: InsertionPoints) -> Array:
    """The points that are not the subject's own insertions."""
    kept: Array = points.positions[[x != "insertion" for x in points.regions]]
    return kept


def check(knee: Knee) -> None:
    femur, tibia = insertion_surfaces(knee)
    sites = [x for lines in structure_sites(knee).values() for x in lines]
    for points, bone in ((femur, "femur"), (tibia, "tibia")):
        assert FEWEST <= len(points.positions) <= MOST
        assert len(points.positions) == len(points.sides) == len(points.regions)
        assert np.isfinite(points.positions).all()
        tree = cKDTree(shell(points))
        places = [getattr(x, bone) for x in (*knee.ligaments, *sites)]
        assert tree.query(places)[0].max() < REACHED
        assert tree.query(tree.data, k=2)[0][:, 1].min() > 1.0


def test_every_insertion_and_site_is_near_a_point(reference: Knee) -> None:
    check(reference)
    check(posed_reference(5))


@pytest.mark.parametrize("name", ["lenhart2015_stable", "lenhart2015"])
def test_points_of_real_knees(name: str) -> None:
    check(example(name))


def test_own_insertions_are_among_them(reference: Knee) -> None:
    femur, tibia = insertion_surfaces(reference)
    for line in reference.ligaments:
        assert (femur.positions == line.femur).all(axis=1).any()
        assert (tibia.positions == line.tibia).all(axis=1).any()


def test_a_knee_without_ligaments_has_points_too(reference: Knee) -> None:
    femur, tibia = insertion_surfaces(reference.with_ligaments([]))
    for points in (femur, tibia):
        assert "insertion" not in points.regions
        assert len(points.positions) >= FEWEST


def test_sides_and_regions(reference: Knee) -> None:
    femur, tibia = insertion_surfaces(reference)
    for points in (femur, tibia):
        for position, side in zip(points.positions, points.sides, strict=True):
            assert side == "central" or (side == "lateral") == (position[2] > 0.0)
    assert set(femur.regions) == {
        "articular",
        "epicondyle",
        "posterior condyle",
        "notch",
        "insertion",
    }
    assert set(tibia.regions) == {
        "anterior rim",
        "middle rim",
        "posterior rim",
        "intercondylar",
        "fibular head",
        "insertion",
    }
    lowest = min(p[1] for p in tibia.positions)
    assert -100.0 < lowest < -75.0


def test_the_same_points_wherever_the_knee_lies() -> None:
    knee = posed_reference(6)
    still = posed_reference(is_moved=False, scale=1.0)
    scale = np.linalg.norm(knee.ligaments[0].femur - knee.ligaments[1].femur) / np.linalg.norm(
        still.ligaments[0].femur - still.ligaments[1].femur
    )
    for here, there in zip(insertion_surfaces(knee), insertion_surfaces(still), strict=True):
        expected = knee.femur_frame.to_common(scale * there.positions)
        np.testing.assert_allclose(here.positions, expected, rtol=0, atol=1e-6)
        assert (here.sides, here.regions) == (there.sides, there.regions)
