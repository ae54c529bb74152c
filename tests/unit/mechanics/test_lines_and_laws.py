"""Force laws where a small fault hides: at joints of two formulas, and in second derivatives."""

import numpy as np
import oracle
import pytest
from energy_evaluation import SCALE, Evaluator, ligaments_of
from tolerances import CLOSED_FORM, DIFFERENCE

from identknee.mechanics.distance_field import MOST_ROUNDING
from identknee.mechanics.elements import line_force, line_shape, tension
from identknee.mechanics.ligament_tensions import line_tensions
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

TOE = 0.03
# Below, at and beyond both ends of the toe, and just before its end: 1.9 for 2.0 shows there.
STRAINS = [-0.01, 0.0, 1e-4, TOE, 1.92 * TOE, 1.96 * TOE, 1.999 * TOE, 2.0 * TOE, 2.02 * TOE, 0.2]


@pytest.mark.parametrize("strain", STRAINS)
def test_the_toe_ends_where_both_formulas_meet(strain: float) -> None:
    """Equation 3 of the paper by the oracle; the straight line is tangent at twice the strain."""
    wanted = oracle.tension(strain, 2500.0, TOE)
    force, _, stored = tension(strain, 2500.0, TOE)
    assert force == pytest.approx(wanted, rel=CLOSED_FORM, abs=1e-12)
    assert stored == pytest.approx(oracle.stored_energy(strain, 2500.0, TOE), rel=1e-10, abs=1e-12)
    (many,), _ = line_tensions(np.array([strain]), np.array([2500.0]), TOE)
    assert many == pytest.approx(wanted, rel=CLOSED_FORM, abs=1e-12)


def test_the_slope_of_the_law_is_that_of_its_force() -> None:
    """Also across the toe's end, where a joint elsewhere would be a corner."""
    for strain in np.linspace(-0.02, 0.1, 241):
        size = 1e-7
        ahead, behind = (tension(strain + x, 2500.0, TOE)[0] for x in (size, -size))
        # The slope itself bends at both ends of the toe.
        assert tension(strain, 2500.0, TOE)[1] == pytest.approx(
            (ahead - behind) / (2.0 * size), abs=0.1
        )


def test_a_spring_pushes_as_it_pulls() -> None:
    assert line_force(-0.1, 500.0, -1.0) == pytest.approx((-50.0, 500.0, 2.5))
    assert line_force(0.1, 500.0, -1.0) == pytest.approx((50.0, 500.0, 2.5))


@pytest.mark.parametrize(("offset", "place"), [(0.0, 0.0), (-6.0, 0.3), (4.0, 0.7)])
def test_a_line_bent_aside_has_the_slopes_of_its_length(offset: float, place: float) -> None:
    """Length in closed form: two straight parts by way of the corner."""
    ends = np.array([3.0, -38.0, 9.0])

    def shape_at(e: Array) -> Array:
        shape = np.zeros(10)
        line_shape(*e, offset, place, shape)
        return shape

    found = shape_at(ends)
    corner = (1.0 - place) * ends + [0.0, 0.0, offset]
    way = np.linalg.norm(corner) + np.linalg.norm(ends - corner)
    assert found[0] == pytest.approx(way, rel=CLOSED_FORM)
    size = 1e-5
    steps = size * np.eye(3)
    slope = [(shape_at(ends + x)[0] - shape_at(ends - x)[0]) / (2.0 * size) for x in steps]
    np.testing.assert_allclose(found[1:4], slope, atol=DIFFERENCE * 1e-2)
    bend = np.array(
        [(shape_at(ends + x)[1:4] - shape_at(ends - x)[1:4]) / (2.0 * size) for x in steps]
    )
    xx, yy, zz, xy, xz, yz = found[4:]
    np.testing.assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], bend, atol=1e-9)


def pressed(model: LaxityModel) -> tuple[float, Array]:
    """The scanned pose with the tibia pushed 0.4 mm into the femur."""
    return model.joint.start_flexion, model.joint.start + 0.4 * np.eye(5)[3]


@pytest.mark.parametrize("exponent", [1.0, 1.25, 1.5])
@pytest.mark.parametrize("rounding", [0.0, MOST_ROUNDING])
def test_the_stiffness_of_contact_is_the_slope_of_its_force(
    exponent: float, rounding: float, reference_model: LaxityModel
) -> None:
    """With an exponent beside 1 the slope of a point's force is that many times its secant."""
    flexion, pose = pressed(reference_model)
    evaluate = Evaluator(reference_model.joint)
    evaluate._contact = evaluate._contact._replace(law=(exponent, rounding))
    theta = reference_model.parameters.center * np.r_[np.zeros(4), np.ones(4)]
    ligaments = ligaments_of(reference_model, theta)
    found = evaluate(flexion, pose, ligaments)
    size = 1e-6
    for k in range(5):
        move = np.zeros(5)
        move[k] = size / SCALE[k]
        ahead, behind = (evaluate(flexion, pose + s * move, ligaments) for s in (1.0, -1.0))
        slope = (ahead.gradient - behind.gradient) / (2.0 * size) / SCALE
        wanted = found.hessian[:, k] / SCALE / SCALE[k]
        # A point that begins to touch has a stiffness of none beside 1, and bends it at 1.
        np.testing.assert_allclose(slope, wanted, atol=2e-3 * np.abs(wanted).max())
        by_energy = (ahead.energy - behind.energy) / (2.0 * size)
        assert by_energy == pytest.approx(found.gradient[k] / SCALE[k], rel=1e-4, abs=1e-3)


def test_the_exponent_leaves_the_pressure_at_three_tenths_alone(
    reference_model: LaxityModel,
) -> None:
    """force = modulus area depth (depth / 0.3 mm)^(exponent - 1), point by point."""
    flexion, pose = pressed(reference_model)
    theta = reference_model.parameters.center * np.r_[np.zeros(4), np.ones(4)]
    ligaments = ligaments_of(reference_model, theta)
    forces, depths = {}, {}
    for exponent in (1.0, 1.4):
        evaluate = Evaluator(reference_model.joint)
        evaluate._contact = evaluate._contact._replace(law=(exponent, evaluate._contact.law[1]))
        evaluate(flexion, pose, ligaments)
        forces[exponent] = np.linalg.norm(evaluate.contact_forces(), axis=1)
        depths[exponent] = evaluate.contact_depths()
    depth = depths[1.0]
    inside = depth > 1e-6
    assert inside.sum() > 20
    assert depth.max() > 0.1
    ratio = forces[1.4][inside] / forces[1.0][inside]
    np.testing.assert_allclose(ratio, (depth[inside] / 0.3) ** 0.4, rtol=1e-9)
