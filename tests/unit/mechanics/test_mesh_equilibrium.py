"""Equilibria under the mesh law on a small made-up knee."""

import numpy as np
import pytest

from identknee.mechanics.equilibria import LineLigaments, LoadPaths, load_paths
from identknee.mechanics.ligament_tensions import ligament_wrench
from identknee.mechanics.mesh_contact import (
    RESIDUAL_TOLERANCE,
    MeshContact,
    MeshEquilibria,
    mesh_contact,
    mesh_equilibria,
)
from identknee.mechanics.pose import place
from identknee.runs.declare import Array, IntArray
from identknee.runs.record import Outcome

FEMORAL = np.array([[3.0, 5.0, 8.0], [-3.0, 5.0, -8.0], [0.0, 12.0, 38.0], [0.0, 12.0, -38.0]])
TIBIAL = np.array([[-12.0, -20.0, 2.0], [12.0, -20.0, -2.0], [4.0, -40.0, 40.0], [4.0, -50.0, -36]])
LINES = LineLigaments(
    femoral=FEMORAL, tibial=TIBIAL, reference_length=np.linalg.norm(FEMORAL - TIBIAL, axis=1)
)
STIFFNESS = np.array([9000.0, 12000.0, 6000.0, 8000.0])
STRAIN = np.array([0.04, 0.03, 0.03, 0.04])


def _flat(half: float, edge: float, centre_z: float) -> tuple[Array, IntArray]:
    ticks = np.arange(-half, half + 0.5 * edge, edge)
    n = len(ticks)
    x, z = np.meshgrid(ticks, ticks + centre_z, indexing="ij")
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    corner = (i * n + j).ravel()
    upward = [[corner, corner + 1, corner + n + 1], [corner, corner + n + 1, corner + n]]
    faces = np.concatenate([np.stack(three, axis=1) for three in upward])
    return np.stack([x.ravel(), np.zeros(n * n), z.ravel()], axis=1), faces


def _contact(pressure: float = 10.0) -> MeshContact:
    """A flat femur, so that the one-way law has an energy, on two domes."""
    femur = _flat(24.0, 2.0, 0.0)
    tibia = []
    for centre_z in (14.0, -14.0):
        vertices, faces = _flat(9.0, 0.75, centre_z)
        vertices[:, 1] = -(vertices[:, 0] ** 2 + (vertices[:, 2] - centre_z) ** 2) / 40.0
        tibia.append((vertices, faces))
    both = mesh_contact((femur[0], femur[1][:, ::-1]), tibia, "tibia")
    return MeshContact(
        femur=both.femur, tibia=both.tibia, convention="tibia", pressure_modulus=pressure
    )


def _paths(varus: float, internal: float, *, scale: float = 1.0) -> LoadPaths:
    load = scale * np.array([varus, internal, 0.0, 0.0, 0.0])
    return load_paths(np.zeros(2), np.stack([np.zeros(5), load]), 0.0)


def _solve(paths: LoadPaths, start: Array | None = None) -> MeshEquilibria:
    start = np.zeros(5) if start is None else start
    return mesh_equilibria(paths, start, _contact(), LINES, STIFFNESS, STRAIN)


def test_forces_balance_where_it_converged() -> None:
    paths = _paths(5000.0, 3000.0)
    found = _solve(paths)
    assert found.outcomes == (Outcome.CONVERGED, Outcome.CONVERGED)
    placement = place(0.0, found.poses[1])
    total = (
        _contact().wrench(placement).force
        + ligament_wrench(placement, LINES, STIFFNESS, STRAIN).force
        + np.array([5000.0, 3000.0, 0.0, 0.0, 0.0])
    )
    residual = np.linalg.norm(total / np.array([40.0, 40.0, 1.0, 1.0, 1.0]))
    assert residual == pytest.approx(found.residuals[1], abs=1e-9)
    assert residual <= RESIDUAL_TOLERANCE
    # The loads turn the tibia their own way.
    assert np.all(found.poses[1, :2] > found.poses[0, :2])


def test_the_start_does_not_matter_nearby() -> None:
    paths = _paths(2000.0, 2000.0)
    here = _solve(paths)
    there = _solve(paths, np.array([0.01, -0.02, 0.5, -0.2, -0.4]))
    # Two residuals of 0.001 N over stiffnesses of a few N/mm.
    assert there.poses == pytest.approx(here.poses, abs=2e-3)


def test_scaling_everything_leaves_the_pose_alike() -> None:
    once = _solve(_paths(4000.0, -2000.0))
    doubled = _paths(4000.0, -2000.0, scale=2.0)
    twice = mesh_equilibria(doubled, np.zeros(5), _contact(20.0), LINES, 2.0 * STIFFNESS, STRAIN)
    assert twice.poses == pytest.approx(once.poses, abs=2e-3)


def test_what_nothing_holds_is_said() -> None:
    slack = np.full(4, -0.5)
    load = np.array([[0.0, 0.0, 0.0, -300.0, 0.0]])
    paths = load_paths(np.zeros(1), load, 0.0)
    found = mesh_equilibria(paths, np.zeros(5), _contact(), LINES, STIFFNESS, slack)
    assert found.outcomes == (Outcome.NO_EQUILIBRIUM,)
    assert found.residuals[0] > 1.0
    assert np.isfinite(found.poses).all()
