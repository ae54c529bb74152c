"""The generator's energy, its wrench and its coordinates against other ways to them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tolerances import CLOSED_FORM, DIFFERENCE

from identknee.blind import energy
from identknee.mechanics.pose import coordinates_from_pose
from identknee.runs.declare import Array

TOE = 0.03


def _poses(n: int) -> Array:
    """Flexion, varus, internal rotation [rad] and a position [mm], shape ``(n, 6)``."""
    generator = np.random.default_rng(3)
    limits = np.array([1.5, 0.3, 0.6, 10.0, 10.0, 10.0])
    return generator.uniform(-limits, limits, (n, 6))


def _matrix(flexion: float, varus: float, internal: float) -> Array:
    matrix: Array = Rotation.from_euler("ZXY", [-flexion, varus, internal]).as_matrix()
    return matrix


def test_angles_are_those_of_the_turns_one_after_the_other() -> None:
    for flexion, varus, internal, *place in _poses(50):
        found = energy.grood_suntay(_matrix(flexion, varus, internal), np.array(place))
        np.testing.assert_allclose(found[3:], [varus, internal, flexion], atol=CLOSED_FORM)


def test_translations_are_oblique_components() -> None:
    """lateral e1 + drawer e2 - distraction e3 is the position."""
    for flexion, varus, internal, *place in _poses(50):
        R = _matrix(flexion, varus, internal)
        lateral, drawer, distraction = energy.grood_suntay(R, np.array(place))[:3]
        floating, tibial = energy.joint_axes(R)
        total = lateral * np.array([0.0, 0.0, 1.0]) + drawer * floating - distraction * tibial
        np.testing.assert_allclose(total, place, atol=1e3 * CLOSED_FORM)


def test_coordinates_agree_with_the_model() -> None:
    for flexion, varus, internal, *place in _poses(50):
        R = _matrix(flexion, varus, internal)
        flexed = _matrix(flexion, 0.0, 0.0).T @ place
        pose = np.array([varus, internal, *flexed])
        found = energy.grood_suntay(R, np.array(place))[:5]
        found[3:] = np.degrees(found[3:])
        np.testing.assert_allclose(found, coordinates_from_pose(pose), atol=1e3 * CLOSED_FORM)


def test_rotation_vectors_turn_as_scipy_says() -> None:
    for vector in np.random.default_rng(0).normal(size=(20, 3)):
        expected = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(energy.turned(vector), expected, atol=10 * CLOSED_FORM)


def test_a_step_keeps_flexion() -> None:
    R, t = _matrix(0.7, 0.1, -0.2), np.zeros(3)
    new_R, new_t = energy.moved(R, t, np.array([3.0, -5.0, 1.0, 2.0, 3.0]), 0.7)
    assert energy.grood_suntay(new_R, new_t)[5] == pytest.approx(0.7, abs=CLOSED_FORM)
    np.testing.assert_array_equal(new_t, [1.0, 2.0, 3.0])


def test_the_smooth_law_stays_within_two_percent_of_the_printed_one() -> None:
    strain = np.linspace(-0.1, 0.2, 1201)
    toe = strain**2 / (4.0 * TOE)
    printed = np.where(strain > 2.0 * TOE, strain - TOE, np.where(strain > 0.0, toe, 0.0))
    smooth = np.array([energy.smooth_tension(x, TOE) for x in strain])
    difference = np.abs(smooth[:, 0] - printed)
    assert 0.0 < difference.max() < 0.02 * TOE
    step = strain[1] - strain[0]
    inner = slice(1, -1)
    by_difference = (smooth[2:, 2] - smooth[:-2, 2]) / (2.0 * step)
    np.testing.assert_allclose(smooth[inner, 0], by_difference, atol=DIFFERENCE)
    assert (np.diff(smooth[:, 0]) > 0.0).all()


def _knee() -> energy.VirtualKnee:
    """A ball on a plane of points, with every kind of element."""
    axis = np.arange(-14.0, 15.0)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    values = np.clip(np.linalg.norm(nodes, axis=-1) - 10.0, -5.0, 5.0)
    side = np.arange(-5.0, 5.1, 0.5)
    x, z = (part.ravel() for part in np.meshgrid(side, side))
    points = np.c_[x, np.full_like(x, -9.6), z]
    surface = energy.TibialSurface(points, np.full(len(points), 0.25), np.array([10.0, 1.3]))
    field = energy.FemurGrid(values, np.full(3, -14.0), 1.0)
    lines = np.zeros((2, 12))
    lines[:, :3] = [[2.0, 9.0, 12.0], [-3.0, 8.0, -12.0]]
    lines[:, 3:6] = [[-1.0, -18.0, 10.0], [1.0, -19.0, -11.0]]
    lines[:, 6:10] = [26.0, 3000.0, 0.04, TOE]
    lines[1, 10:] = -4.0, 0.4
    weights = np.array([[3.0, -9.0, 2.0, 1.0, -180.0, 2.0]])
    springs = np.array([[0.0, 2.0, 5.0, 1.0, 2.0, 4.0, 20.0]])
    # One pad is pressed, one is not, one lies beside the grid.
    pads = np.array([[5.0, -10.0, 3.0, 8.0, 2.5], [0.0, -12.5, 6.0, 8.0, 1.0], [0, -40, 0, 8, 2]])
    torsion = np.array([3000.0, 0.1])
    return energy.VirtualKnee(
        surface, field, lines, weights, springs, torsion, pads.astype(float), field
    )


def test_the_gradient_is_the_slope_of_the_energy() -> None:
    knee = _knee()
    R, t = _matrix(0.4, 0.05, -0.1), np.array([0.3, 0.2, -0.1])
    load = np.array([3000.0, -5000.0, 20.0, -30.0, 10.0])
    every = np.arange(21 * 21)
    gradient, other, touching = np.empty(5), np.empty(5), np.empty(len(every), np.int64)

    def energy_at(step: Array) -> float:
        place = energy.moved(R, t, step, 0.4)
        return float(energy.energy_of(*place, load, knee, every, other, touching)[0])

    _, n_touching = energy.energy_of(R, t, load, knee, every, gradient, touching)
    assert 0 < n_touching < len(every)
    size = 1e-4
    slopes = [(energy_at(x) - energy_at(-x)) / (2.0 * size) for x in size * np.eye(5)]
    np.testing.assert_allclose(gradient, slopes, atol=DIFFERENCE, rtol=DIFFERENCE)


def test_no_point_that_touches_is_left_out() -> None:
    knee = _knee()
    R, t = _matrix(0.4, 0.05, -0.1), np.array([0.3, 0.2, -0.1])
    load, gradient = np.zeros(5), np.empty((2, 5))
    every, scratch = np.arange(21 * 21), np.empty(21 * 21, np.int64)
    listed = energy.candidates(R, t, knee.surface, knee.field, 0.0)
    assert len(listed) < len(every)
    full = energy.energy_of(R, t, load, knee, every, gradient[0], scratch)
    few = energy.energy_of(R, t, load, knee, listed, gradient[1], scratch)
    assert full == few
    np.testing.assert_array_equal(*gradient)
