"""Places found on a knee, and that they move along with it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posed_knees import posed_folder, posed_reference
from scipy.spatial import cKDTree

from identknee.runs.declare import Array
from identknee.subject.anatomy import Anatomy, anatomy, rim_point
from identknee.subject.folder import example, read_subject
from identknee.subject.insertion_sites import structure_sites
from identknee.subject.knee import Knee
from identknee.subject.reference import Condyle
from identknee.subject.surface import Surface, joined

# Positions are a few hundred mm, sums of thousands of vertices: far above rounding.
EQUIVARIANT = 1e-6
# The faces of a sphere's mesh lie within it by about a sixth of edge^2 / radius.
FACETED = 0.02
# Two knees at hand made the estimates; each is off their mean by no more.
ESTIMATE = 3.0
# Averaging over an arc and a narrow band leaves a point so far within the rim [mm].
NEAR_RIM = 1.0

ROLES = ("medial_collateral", "lateral_collateral", "anterior_cruciate", "posterior_cruciate")


def roles(found: Anatomy) -> tuple[str | None, ...]:
    return tuple(getattr(found, x) for x in ROLES)


def places(knee: Knee) -> Array:
    """Every place that is found, shape ``(n, 3)``."""
    found = anatomy(knee)
    names = ("condyle_centre", "epicondyle", "collateral_femur", "plateau_centre")
    margins = ("anterior_margin", "posterior_margin")
    sides = [getattr(side, x) for side in found.compartments for x in (*names, *margins)]
    rims = [rim_point(x, knee.tibia_frame, 2.0) for x in found.compartments]
    sites = [x for lines in structure_sites(knee).values() for x in lines]
    ends = [end for x in sites for end in (x.femur, x.tibia)]
    return np.array([found.fibular_head, *sides, *rims, *ends])


def without(knee: Knee, *names: str) -> Knee:
    return knee.with_ligaments([x for x in knee.ligaments if x.name not in names])


def with_condyles(knee: Knee, *centres: tuple[float, float, float]) -> Knee:
    """The knee with spheres of 20 mm for condyles."""
    spheres = [
        Condyle(
            distal_radius=20.0,
            posterior_radius=20.0,
            transition_centre=30.0,
            transition_half_width=20.0,
            tube_radius=20.0 - 1e-6,
            spine_x=x,
            spine_y=y,
            spine_z=z,
            divergence=0.0,
            first_angle=-60.0,
            last_angle=130.0,
            half_aperture=75.0,
        ).mesh(0.8)
        for x, y, z in centres
    ]
    return replace(knee, femur=joined(*spheres), femur_distance=None)


@pytest.mark.parametrize("seed", [0, 1])
def test_places_move_turn_and_grow_with_the_knee(seed: int) -> None:
    scale = 1.08
    still = places(posed_reference(is_moved=False, scale=1.0))
    knee = posed_reference(seed, scale=scale)
    there = knee.femur_frame.to_common(scale * still)
    np.testing.assert_allclose(places(knee), there, rtol=0, atol=EQUIVARIANT)


def test_a_left_knee_in_a_folder_has_the_same_places(tmp_path: Path) -> None:
    left = read_subject(posed_folder(tmp_path, 2, side="left"))
    there = places(posed_reference(2))
    np.testing.assert_allclose(places(left), there, rtol=0, atol=EQUIVARIANT)


def test_a_flexed_scan_leaves_the_femur_its_places(reference: Knee) -> None:
    angle = np.radians(25.0)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    frame = replace(reference.femur_frame, axes=reference.femur_frame.axes @ turn.T)
    flexed = replace(
        reference,
        femur=reference.femur.moved(turn, np.zeros(3)),
        femur_frame=frame,
        ligaments=tuple(replace(x, femur=turn @ x.femur) for x in reference.ligaments),
        femur_distance=None,
    )
    before, after = anatomy(reference), anatomy(flexed)
    assert roles(after) == roles(before)
    for one, other in zip(before.compartments, after.compartments, strict=True):
        for name in ("condyle_centre", "epicondyle"):
            moved = turn @ getattr(one, name)
            np.testing.assert_allclose(getattr(other, name), moved, rtol=0, atol=EQUIVARIANT)


def test_condyles_that_are_spheres(reference: Knee) -> None:
    centres = ((-2.0, 3.0, -24.0), (-4.0, 1.0, 21.0))
    found = anatomy(with_condyles(reference, *centres))
    for side, centre in zip(found.compartments, centres, strict=True):
        np.testing.assert_allclose(side.condyle_centre, centre, rtol=0, atol=FACETED)
        assert side.condyle_radius == pytest.approx(20.0, abs=FACETED)


def test_a_femur_without_one_condyle_is_refused(reference: Knee) -> None:
    with pytest.raises(ValueError, match="lateral condyle"):
        anatomy(with_condyles(reference, (-2.0, 3.0, -24.0)))


@pytest.mark.parametrize("name", ["lenhart2015_stable", "lenhart2015"])
def test_ligaments_of_real_knees(name: str) -> None:
    assert roles(anatomy(example(name))) == ("MCL", "LCL", "ACL", "PCL")


def test_ligaments_are_known_by_where_they_run_not_by_name_or_order(reference: Knee) -> None:
    names = ("inner", "outer", "cruciate_front", "cruciate_back")
    assert roles(anatomy(reference)) == ("MCL", "LCL", "ACL", "PCL")
    knee = posed_reference()
    assert roles(anatomy(knee)) == names
    assert roles(anatomy(knee.with_ligaments(knee.ligaments[::-1]))) == names


def test_a_missing_structure_is_not_taken_for_a_ligament(reference: Knee) -> None:
    sites = [x for lines in structure_sites(reference).values() for x in lines]
    template = reference.ligaments[0]
    more = [replace(template, name=x.name, femur=x.femur, tibia=x.tibia) for x in sites]
    assert roles(anatomy(reference.with_ligaments([*reference.ligaments, *more]))) == (
        "MCL",
        "LCL",
        "ACL",
        "PCL",
    )


def test_without_collaterals_the_surfaces_must_do(reference: Knee) -> None:
    whole, bare = anatomy(reference), anatomy(reference.with_ligaments([]))
    assert roles(bare) == (None,) * 4
    assert np.linalg.norm(bare.fibular_head - whole.fibular_head) < ESTIMATE
    for with_line, estimate in zip(whole.compartments, bare.compartments, strict=True):
        axis = estimate.epicondyle - estimate.condyle_centre
        cartilage = max(reference.femur.vertices @ axis / np.linalg.norm(axis))
        assert estimate.epicondyle @ axis / np.linalg.norm(axis) > cartilage
        for name in ("epicondyle", "collateral_femur"):
            apart = np.linalg.norm(getattr(estimate, name) - getattr(with_line, name))
            assert apart < 2.0 * ESTIMATE


def test_one_collateral_alone(reference: Knee) -> None:
    found = anatomy(without(reference, "LCL"))
    whole = anatomy(reference)
    assert found.lateral_collateral is None
    np.testing.assert_array_equal(found.medial.epicondyle, whole.medial.epicondyle)
    assert not np.array_equal(found.lateral.epicondyle, whole.lateral.epicondyle)


def test_epicondyles_lie_on_the_flexion_axis_at_the_width_of_the_collaterals(
    reference: Knee,
) -> None:
    found = anatomy(reference)
    axis = found.lateral.condyle_centre - found.medial.condyle_centre
    for side, name in zip(found.compartments, ("MCL", "LCL"), strict=True):
        away = side.epicondyle - side.condyle_centre
        np.testing.assert_allclose(np.cross(away, axis), 0.0, atol=EQUIVARIANT)
        assert (side.epicondyle - reference.ligament(name).femur) @ axis == pytest.approx(0.0)


def reach(sheet: Surface, axis: int, pick: Callable[[Array], float]) -> float:
    return float(pick(sheet.vertices[:, axis]))


def test_margins_are_as_far_out_as_the_surfaces(reference: Knee) -> None:
    found = anatomy(reference)
    for side in found.compartments:
        sheet = side.tibia
        assert side.anterior_margin[0] == pytest.approx(reach(sheet, 0, np.max))
        assert side.posterior_margin[0] == pytest.approx(reach(sheet, 0, np.min))
    assert found.joint_line == pytest.approx(
        np.mean([x.plateau_centre[1] for x in found.compartments])
    )


def test_rim_points_lie_at_the_rim_all_around(reference: Knee) -> None:
    for side in anatomy(reference).compartments:
        rim = cKDTree(side.tibia.vertices[np.unique(side.tibia.boundary_edges)])
        for angle in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False):
            point = rim_point(side, reference.tibia_frame, angle)
            assert rim.query(point)[0] < NEAR_RIM
        outward = rim_point(side, reference.tibia_frame, 0.5 * np.pi) - side.plateau_centre
        assert outward[2] * side.outward > 10.0
        backward = rim_point(side, reference.tibia_frame, np.pi) - side.plateau_centre
        assert backward[0] < -10.0


def test_rim_points_of_a_closed_surface(reference: Knee) -> None:
    side = anatomy(reference).medial
    sheet = side.tibia
    bottom = Surface(vertices=sheet.vertices - [0.0, 0.5, 0.0], faces=sheet.faces[:, ::-1])
    doubled = replace(side, tibia=joined(sheet, bottom))
    for angle in (0.0, 1.0, 2.0, 3.0):
        one = rim_point(side, reference.tibia_frame, angle)
        other = rim_point(doubled, reference.tibia_frame, angle)
        np.testing.assert_allclose(one[[0, 2]], other[[0, 2]], rtol=0, atol=EQUIVARIANT)
