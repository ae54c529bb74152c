"""Trials whose load path ends, looked for at their measured poses."""

from dataclasses import replace

import numpy as np
import pytest

import identknee as ik
from identknee.laxity.table import Laxity
from identknee.mechanics.equilibria import NEAR
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee, Uncertainty


@pytest.fixture(scope="module")
def given() -> tuple[Knee, Laxity]:
    """A knee whose insertions are given 4 mm off, which loses most trials, and its laxity."""
    knee = ik.reference_knee(edge_mm=2.0)
    truth = LaxityModel(knee=knee, protocol=ik.load_protocol("table2"))
    generator = np.random.default_rng(14)
    moved = [
        replace(
            x,
            femur=x.femur + generator.normal(0.0, 4.0, 3),
            tibia=x.tibia + generator.normal(0.0, 4.0, 3),
        )
        for x in knee.ligaments
    ]
    wrong = knee.with_ligaments(moved).with_uncertainty(Uncertainty(insertions_mm=4.0))
    return wrong, truth.simulate(truth.parameters.start)


def test_equilibria_at_measured_poses_have_exact_slopes(given: tuple[Knee, Laxity]) -> None:
    knee, laxity = given
    path = LaxityModel(knee=knee, protocol=laxity.protocol)
    model = path.with_tests(laxity)
    theta = path.parameters.start
    along, found = path.predict(theta), model.predict(theta)
    back = found.is_converged & ~along.is_converged
    assert back.sum() > 5
    np.testing.assert_array_equal(found.poses[along.is_converged], along.poses[along.is_converged])
    far = np.abs(found.coordinates[back][:, :3] - laxity.coordinates[back][:, :3])
    assert far.max() < NEAR
    assert found.margins[back].min() > 0.0
    i = model.parameters.index("ACL.reference_strain_pct")
    step = np.zeros(theta.size)
    step[i] = 1e-4
    ends = [model.predict(theta + x * step, derivatives=False).coordinates for x in (1, -1)]
    slopes = (ends[0] - ends[1])[back] / 2e-4
    assert found.jacobian is not None
    np.testing.assert_allclose(found.jacobian[back][:, :, i], slopes, rtol=1e-4, atol=1e-5)


def test_a_warm_start_changes_nothing(given: tuple[Knee, Laxity]) -> None:
    knee, laxity = given
    model = LaxityModel(knee=knee, protocol=laxity.protocol).with_tests(laxity)
    theta = model.parameters.start
    near = model.predict(theta * (1.0 + 1e-3))
    cold, warm = model.predict(theta), model.predict(theta, near=near)
    np.testing.assert_array_equal(cold.is_converged, warm.is_converged)
    np.testing.assert_allclose(warm.coordinates, cold.coordinates, atol=1e-7)


def test_only_measured_trials_of_a_knee_that_is_not_exact_have_another_way(
    given: tuple[Knee, Laxity],
) -> None:
    knee, laxity = given
    exact = LaxityModel(knee=knee.with_uncertainty(Uncertainty()), protocol=laxity.protocol)
    assert exact.with_tests(laxity).fallback_poses is None
    model = LaxityModel(knee=knee, protocol=laxity.protocol).with_tests(laxity)
    assert model.with_tests(laxity) is model
    other = ik.load_protocol("drawer")
    poses = model.with_protocol(other).fallback_poses
    assert poses is not None
    # It shares the unloaded trials.
    is_made = np.isin(other.trials, laxity.protocol.trials)
    assert np.isnan(poses[~is_made]).all()
    part = laxity.protocol.select(np.arange(laxity.n) < 3)
    poses = model.with_protocol(part).fallback_poses
    assert poses is not None
    assert np.isfinite(poses).all()
