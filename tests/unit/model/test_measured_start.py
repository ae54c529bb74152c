"""Models that begin where the tibia was measured."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

from identknee.laxity.protocol import Protocol, concatenate
from identknee.laxity.table import Laxity, read_laxity
from identknee.mechanics.pose import coordinates_from_pose
from identknee.model.candidate_laxity import CandidateLaxity, offered_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import measured_poses, poses_of, strains_as_measured
from identknee.runs.record import Outcome
from identknee.subject.knee import pose_at


def as_read() -> Protocol:
    """Loaded trials at angles as a rig reads them, no two alike."""
    nominal = small_protocol()
    loaded = nominal.select(~nominal.is_unloaded)
    return replace(loaded, flexion_deg=loaded.flexion_deg + 0.13 * np.arange(1, loaded.n + 1))


def as_measured(off: float = 0.0) -> Laxity:
    """What the knee does in these trials, each coordinate off by some mm and deg."""
    model = LaxityModel(knee=small_knee(), protocol=as_read())
    exact = model.simulate(model.parameters.start)
    noise = off * np.random.default_rng(1).standard_normal((exact.n, 5))
    return replace(exact, coordinates=exact.coordinates + noise)


def begun(laxity: Laxity) -> LaxityModel:
    return LaxityModel(knee=small_knee(), protocol=laxity.protocol).with_tests(laxity)


def test_from_the_measured_pose_the_same_equilibria_are_found() -> None:
    laxity = as_measured(off=2.0)
    model = begun(laxity)
    canonical = replace(model, poses=None)
    theta = model.parameters.start
    assert len(model.paths.flexion) == laxity.n < len(canonical.paths.flexion)
    found, expected = model.predict(theta), canonical.predict(theta)
    np.testing.assert_allclose(found.coordinates, expected.coordinates, atol=1e-9)
    assert found.jacobian is not None
    assert expected.jacobian is not None
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=1e-6, atol=1e-8)


def test_residuals_made_of_residuals_share_a_model_and_so_its_predictions() -> None:
    laxity = replace(as_measured(off=1.0), protocol=as_read())
    model = begun(as_measured()).with_tests(laxity)
    assert model.protocol is laxity.protocol
    assert model.with_tests(laxity) is model


def test_an_equilibrium_far_from_the_measured_pose_does_not_count() -> None:
    laxity = as_measured()
    coordinates = np.array(laxity.coordinates)
    coordinates[1, 4] += 60.0
    model = begun(replace(laxity, coordinates=coordinates))
    found = model.predict(model.parameters.start)
    assert np.flatnonzero(~found.is_converged).tolist() == [1]
    assert found.outcomes[1] is Outcome.NO_EQUILIBRIUM
    assert "step" not in found.reasons[1]


def test_angles_as_set_begin_at_the_scanned_pose() -> None:
    laxity = as_measured()
    whole = replace(laxity.protocol, flexion_deg=np.round(laxity.protocol.flexion_deg))
    shared = np.repeat(laxity.protocol.flexion_deg[::3], 3)[: laxity.n]
    others = (
        replace(laxity, protocol=whole),
        replace(laxity, protocol=replace(laxity.protocol, flexion_deg=shared)),
        replace(laxity, zero="unloaded"),
    )
    assert measured_poses(laxity) is not None
    assert [measured_poses(x) for x in others] == [None] * len(others)
    single_step = LaxityModel(
        knee=small_knee(), protocol=laxity.protocol, continuation="single-step"
    )
    assert single_step.with_tests(laxity).poses is None
    assert begun(laxity).with_tests(replace(laxity, protocol=whole)).poses is None


def test_a_second_reading_at_the_same_angle_leaves_the_others_theirs() -> None:
    laxity = as_measured()
    twice = np.array(laxity.protocol.flexion_deg)
    twice[1] = twice[0]
    read_again = replace(laxity, protocol=replace(laxity.protocol, flexion_deg=twice))
    np.testing.assert_array_equal(measured_poses(read_again), measured_poses(laxity))


def test_another_trial_begins_between_the_poses_of_those_made() -> None:
    laxity = as_measured()
    model = begun(laxity)
    assert model.poses is not None
    own = laxity.protocol.select([2, 0])
    np.testing.assert_array_equal(model.with_protocol(own).poses, model.poses[[2, 0]])
    stronger = replace(own, loads=own.loads * 1.1)
    poses = model.with_protocol(stronger).poses
    assert poses is not None
    angles = laxity.protocol.flexion_deg
    middle = poses_of(laxity.protocol, laxity.coordinates)
    expected = pose_at(middle, stronger.flexion_deg)
    np.testing.assert_allclose(coordinates_from_pose(poses), expected, atol=1e-9)
    assert len(middle) < len(angles)


def test_offered_trials_have_the_equilibria_of_paths_from_the_scanned_pose() -> None:
    model = begun(as_measured(off=2.0))
    theta, made, new = model.parameters.start, model.protocol, small_protocol()
    new = replace(new, trials=tuple(f"new {x}" for x in new.trials))
    offered = CandidateLaxity(
        model=model,
        laxity=as_measured(),
        protocol=concatenate([made, new]),
        sd=np.ones(5),
        free=model.parameters.with_fixed((), theta),
    ).with_start_poses(theta)
    scanned = LaxityModel(knee=small_knee(), protocol=small_protocol())
    assert offered.model.poses is not None
    np.testing.assert_array_equal(offered.model.poses[: made.n], model.poses)
    found, _ = offered.predict(theta, range(made.n, offered.protocol.n))
    np.testing.assert_allclose(found, scanned.predict(theta).coordinates, atol=1e-8)


def test_angles_away_from_those_measured_are_not_offered() -> None:
    laxity = as_measured()
    model = begun(laxity)
    new = offered_laxity(model, laxity.protocol).flexion_deg[laxity.n :]
    assert laxity.protocol.flexion_deg.max() < 15.0
    assert set(new.tolist()) == {0.0, 15.0}
    scanned = replace(model, poses=None)
    assert offered_laxity(scanned, laxity.protocol).flexion_deg.max() == 120.0


def test_a_cell_not_measured_is_that_of_the_trial_nearest_in_flexion() -> None:
    laxity = read_laxity("s192803")
    coordinates = np.array(laxity.coordinates)
    coordinates[0, 2] = np.nan
    poses = measured_poses(replace(laxity, coordinates=coordinates))
    assert poses is not None
    apart = np.abs(laxity.protocol.flexion_deg - laxity.protocol.flexion_deg[0])
    apart[0] = np.inf
    coordinates[0, 2] = laxity.coordinates[int(np.argmin(apart)), 2]
    np.testing.assert_allclose(coordinates_from_pose(poses), coordinates, atol=1e-9)


def test_strains_are_those_of_the_longest_measured_length() -> None:
    model = begun(as_measured())
    strains = strains_as_measured(model.setting(model.parameters.start), 0.05)
    n = model.n_ligament_parameters // 2
    theta = np.array(model.parameters.start)
    theta[n:] = strains
    setting = model.setting(theta)
    femur, tibia = np.asarray(setting.lines.femoral), np.asarray(setting.lines.tibial)
    lengths = []
    for angle, (varus, internal, *origin) in zip(setting.flexion, model.poses, strict=True):  # type: ignore[arg-type]
        flexed = _turn(2, -angle)
        place = flexed @ _turn(0, varus) @ _turn(1, internal)
        lengths.append(np.linalg.norm(tibia @ place.T + flexed @ origin - femur, axis=1))
    slack = np.asarray(setting.lines.reference_length) / (1.0 + strains / 100.0)
    np.testing.assert_allclose((np.max(lengths, axis=0) / slack - 1.0)[:n], 0.05, atol=1e-12)
    with pytest.raises(ValueError, match="begins there"):
        strains_as_measured(replace(setting, measured=None), 0.05)


def test_a_pose_that_no_knee_has_does_not_set_the_strains() -> None:
    table = as_measured()
    coordinates = np.array(table.coordinates)
    coordinates[2, 2] += 60.0
    sound, wrong = (begun(x) for x in (table, replace(table, coordinates=coordinates)))
    strains, beside = (
        strains_as_measured(x.setting(x.parameters.start), 0.05) for x in (sound, wrong)
    )
    # Where the trial was the longest, the next longest takes its place: no shorter, so no slacker.
    assert np.all(beside >= strains - 1e-9)
    assert np.all(beside < strains + 5.0)


def _turn(axis: int, angle: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[a, a] = turn[b, b] = np.cos(angle)
    turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
    return turn
