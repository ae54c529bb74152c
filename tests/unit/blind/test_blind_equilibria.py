"""Equilibria of the generator where they are formulas: springs, a flat plateau, and a ball."""

from pathlib import Path

import numpy as np
import pytest

from identknee.blind import energy, equilibrium, experiment
from identknee.blind.experiment import BAND_MM, distance_grid
from identknee.runs.declare import Array
from identknee.subject.reference import reference_knee

MODULUS, EXPONENT = 8.6, 1.25
# Of a pose, from a residual of 2e-6 N over stiffnesses of 10 N/mm and more.
FOUND_MM = 1e-6
SPRING_N_PER_MM, TORSION_NMM = 40.0, 20_000.0


def flat_joint() -> energy.VirtualKnee:
    """A femur that fills all above y = 0, on nine tibial points of 4 mm2 held by springs."""
    height = np.arange(20.0) - 10.0
    values = np.broadcast_to(-height[None, :, None], (20, 20, 20)).copy()
    side = np.array([-4.0, 0.0, 4.0])
    x, z = (part.ravel() for part in np.meshgrid(side, side))
    points = np.c_[x, np.zeros(9), z]
    law = np.array([MODULUS, EXPONENT])
    surface = energy.TibialSurface(points, np.full(9, 4.0), law)
    springs = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, SPRING_N_PER_MM]])
    field = energy.FemurGrid(values, np.full(3, -10.0), 1.0)
    torsion = np.array([TORSION_NMM, 0.0])
    lines, weights = np.zeros((0, 12)), np.zeros((0, 6))
    pads = np.zeros((0, 5))
    return energy.VirtualKnee(surface, field, lines, weights, springs, torsion, pads, field)


def at_rest(load: Array) -> Array:
    """Coordinates [mm, rad] of the equilibrium under a load."""
    start = np.array([0.1, 0.1, -0.1])
    is_found, R, t, _ = equilibrium.minimum(np.eye(3), start, 0.0, load, flat_joint())
    assert is_found
    found: Array = energy.grood_suntay(R, t)
    return found


@pytest.mark.parametrize("force", [20.0, 200.0, 900.0])
def test_pressed_together_the_bones_sink_in_by_the_power_law(force: float) -> None:
    """F = n A M d (d / 0.3 mm)^(e - 1); distraction is against it, and depth against that."""
    _, _, distraction, varus, internal, flexion = at_rest(np.array([0.0, 0.0, 0.0, -force, 0.0]))
    depth = (force / (9 * 4.0 * MODULUS) * 0.3 ** (EXPONENT - 1.0)) ** (1.0 / EXPONENT)
    assert distraction == pytest.approx(-depth, abs=FOUND_MM)
    np.testing.assert_allclose([varus, internal, flexion], 0.0, atol=1e-9)


def test_each_load_moves_what_it_is_named_after_the_way_it_points() -> None:
    """By the force over the spring, and the moment over the torsion spring."""
    pressed = np.array([0.0, 0.0, 0.0, -300.0, 0.0])
    forwards = at_rest(pressed + 10.0 * np.eye(5)[2])
    assert forwards[1] == pytest.approx(10.0 / SPRING_N_PER_MM, abs=FOUND_MM)
    aside = at_rest(pressed + 10.0 * np.eye(5)[4])
    # The plateau tilts a little under a force that acts above it.
    assert aside[0] == pytest.approx(10.0 / SPRING_N_PER_MM, abs=5e-3)
    turned = at_rest(pressed + 1000.0 * np.eye(5)[1])
    assert turned[4] == pytest.approx(1000.0 / TORSION_NMM, abs=1e-7)
    tilted = at_rest(pressed + 100.0 * np.eye(5)[0])
    assert tilted[3] > 1e-4
    np.testing.assert_allclose(tilted[[1, 4]], 0.0, atol=1e-6)


def test_a_tilt_has_the_stiffness_of_its_points() -> None:
    """Three rows of points on a flat femur: moment over angle is the sum of k z^2."""
    force, moment = 300.0, 1.0
    _, _, distraction, varus, *_ = at_rest(np.array([moment, 0.0, 0.0, -force, 0.0]))
    stiffness = EXPONENT * force / -distraction  # of all nine points together
    lever = stiffness * (16.0 * 6.0 / 9.0)
    assert varus == pytest.approx(moment / lever, rel=1e-2)


def test_a_path_arrives_where_a_search_from_nearby_does() -> None:
    load = np.array([500.0, 1500.0, 15.0, -250.0, 5.0])
    joint = flat_joint()
    rest = equilibrium.minimum(np.eye(3), np.zeros(3), 0.0, np.array([0, 0, 0, -20.0, 0]), joint)
    loads = np.array([[0.0, 0.0, 0.0, -20.0, 0.0], load])
    state, R, t, H = equilibrium.follow(rest[1], rest[2], np.zeros(2), loads, joint)
    assert state == equilibrium.FOUND
    np.testing.assert_allclose(energy.grood_suntay(R, t), at_rest(load), atol=1e-6)
    assert np.linalg.eigvalsh(H)[0] > 0.0


def test_the_distance_to_the_femur_is_that_of_its_formula_or_its_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference knee has both: the mesh is off by less than what its facets are flat."""
    monkeypatch.setattr(experiment, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(experiment, "SPACING_MM", 3.0)
    knee = reference_knee()
    assert knee.femur_distance is not None
    grid = distance_grid(knee)
    nodes = np.stack(np.meshgrid(*map(np.arange, grid.values.shape), indexing="ij"), axis=-1)
    places = grid.origin + grid.spacing * nodes.reshape(-1, 3)
    exact = knee.femur_distance(knee.femur_frame.to_common(places)).reshape(grid.values.shape)
    np.testing.assert_array_equal(grid.values, np.clip(exact, -BAND_MM, BAND_MM))
    # Outside is positive: far below the femur and far above.
    assert grid.values[:, 0].min() > 0.0
    surface = type(knee.femur)(
        vertices=knee.femur_frame.to_local(knee.femur.vertices), faces=knee.femur.faces
    )
    inner = np.setdiff1d(np.arange(len(surface.vertices)), surface.boundary_edges)[::20]
    normals = experiment.vertex_normals(surface)[inner]
    for height in (-0.5, 0.0, 0.5):
        above = surface.vertices[inner] + height * normals
        wanted = knee.femur_distance(knee.femur_frame.to_common(above))
        apart = experiment._from_vertices(surface, above) - wanted
        # Near the rim the mesh knows of one side alone.
        assert np.quantile(np.abs(apart), 0.9) < 0.1
        assert abs(np.median(apart)) < 0.05
        assert np.median(wanted) == pytest.approx(height, abs=0.05)
