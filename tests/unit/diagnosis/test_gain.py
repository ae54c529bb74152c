"""What a planted cause gains on a small knee, and what a Gaussian process does in its place."""

import json
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_knee import small_knee

from identknee.diagnosis import gain as gain_module
from identknee.diagnosis.fitting import FittedModel, best_fit_from
from identknee.diagnosis.gain import FAMILIES, FLEXION, Gain, ParameterChange, measure_gain
from identknee.diagnosis.noise_model import build_noise_model
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import add_noise
from identknee.model.effects.effect import Effect
from identknee.model.effects.loads import compression
from identknee.model.effects.structures import MissingStructure, structure_at
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.runs.files import plain
from identknee.runs.schema import summary_of
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import gain_found

SD_MM, SD_DEG = 0.02, 0.1
PLANTED = [0.08, 1.0]  # kN, %
ANGLES = (0.0, 4.0, 8.0)
INTERNAL, VARUS = (-0.4, -0.2, 0.2, 0.4), (-0.8, -0.4, 0.4, 0.8)


def protocol() -> Protocol:
    loads = [(0.0, 0.0), *((x, 0.0) for x in INTERNAL), *((0.0, x) for x in VARUS)]
    rows = [(angle, *load) for angle in ANGLES for load in loads]
    return Protocol(
        name="two moments",
        trials=tuple(f"{angle:g} deg, {x:g} and {y:g}" for angle, x, y in rows),
        flexion_deg=np.array([row[0] for row in rows]),
        loads=np.array([[x, y, 0.0, 0.0, 0.0] for _, x, y in rows]),
    )


def structure(knee: Knee) -> MissingStructure:
    """A line at the outer front that resists internal rotation, where the knee lies."""
    frame = knee.femur_frame
    femoral, tibial = (
        np.array(x) @ frame.axes + frame.origin for x in ([-3.0, 2.0, 19.0], [8.0, -14.0, 17.0])
    )
    return structure_at(
        knee, "outer_front", [(femoral, tibial)], stiffness_sd=1.0, sites_vary=False
    )


def sds() -> Array:
    return np.broadcast_to(np.r_[3 * [SD_MM], 2 * [SD_DEG]], (protocol().n, 5)).copy()


def fits(
    knee: Knee, effect: Effect, values: list[float], *, seed: int = 0
) -> tuple[FittedModel, FittedModel]:
    """The base model and the one with the effect, fitted to data that hold it."""
    base = LaxityModel(knee=knee, protocol=protocol())
    extended = base.with_effects([effect])
    theta = np.r_[base.parameters.center, values]
    laxity = add_noise(extended.simulate(theta), sd_mm=SD_MM, sd_deg=SD_DEG, seed=seed)
    noise = build_noise_model(sds(), laxity.is_measured, correlation=0.0)
    before = best_fit_from(base, laxity, noise, [base.parameters.center])
    return before, best_fit_from(extended, laxity, noise, [theta])


@cache
def planted() -> Gain:
    """The gain by a missing structure."""
    knee = small_knee(names=("a", "b", "c", "d"))
    return measure_gain(*fits(knee, structure(knee), PLANTED), sds())


def change(gain: Gain, name: str) -> ParameterChange:
    return next(x for x in gain.parameters if x.name == name)


def test_the_cause_predicts_held_trials_better() -> None:
    gain = planted()
    assert gain.before.check.p_value < 1e-6
    assert gain.after.check.p_value > 0.01
    before, after = (gain.rmse_held_out(x).noise for x in (gain.before, gain.after))
    assert after < 0.7 * before
    # The truth is the middle of its prior, so that it does better than it expects.
    assert after < gain.expected_rmse(gain.after).noise
    assert gain.elpd.difference > 2 * gain.elpd.se
    assert sum(x.difference > 2.0 * x.se for x in gain.elpd.families) >= 2
    assert gain.log_evidence_difference > 10


def test_of_very_many_trials_some_are_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = planted()
    most = whole.before.errors.size // 2
    monkeypatch.setattr(gain_module, "MOST_VALUES", most)
    knee = small_knee(names=("a", "b", "c", "d"))
    gain = measure_gain(*fits(knee, structure(knee), PLANTED), sds())
    assert gain.before.errors.size == whole.before.errors.size
    assert gain.log_evidence_difference == whole.log_evidence_difference
    assert most - 5 < gain.discrepancy.errors.size <= most
    assert gain.before.held_out.observations.sd.size == gain.discrepancy.errors.size
    before, after = (gain.rmse_held_out(x).noise for x in (gain.before, gain.after))
    assert after < 0.7 * before


def test_the_process_absorbs_the_misfit_but_does_not_carry_to_new_flexion() -> None:
    gain = planted()
    assert gain.absorbed.in_sample.noise < 1.15 * gain.after.in_sample.noise
    after, absorbed = (gain.rmse_held_out(x, FLEXION).noise for x in (gain.after, gain.absorbed))
    assert absorbed > after
    assert gain.elpd_absorbed.difference < gain.elpd.difference
    # It leaves the parameters where the cause's absence put them.
    wrong = change(gain, "d.stiffness_kN")
    assert abs(wrong.shift) > 5


def test_parameters_are_told_before_and_after() -> None:
    gain = planted()
    truth = LaxityModel(knee=small_knee(names=("a", "b", "c", "d")), protocol=protocol())
    center = truth.parameters.center
    errors = np.array([[x.before, x.after] for x in gain.parameters]) - center[:, None]
    assert np.median(np.abs(errors[:, 1])) < 0.5 * np.median(np.abs(errors[:, 0]))
    inside = []
    for x, value in zip(gain.parameters, center, strict=True):
        low, high = x.interval_after
        inside.append((low is None or low <= value) and (high is None or value <= high))
    assert np.count_nonzero(inside) >= len(inside) - 1
    # The posteriors of the planted cause are closed on nearly all sides.
    ends = [end for x in gain.parameters for end in x.interval_after]
    assert ends.count(None) <= 2
    assert [x.name for x in gain.parameters] == list(truth.parameters.names)
    for x in gain.parameters:
        low, high = x.interval_before
        assert low is None or low < x.before
        assert high is None or x.before < high
        assert x.interval_ratio > 0 or None in (*x.interval_before, *x.interval_after)


def test_forces_are_compared_under_the_largest_loads() -> None:
    forces = planted().forces
    assert forces.ligaments == ("a", "b", "c", "d")
    # One of two sizes of each moment and direction, at every angle.
    assert len(forces.trials) == len(ANGLES) * 4
    assert forces.before.shape == forces.after.shape == (12, 4)
    assert np.abs(forces.after - forces.before).max() > 5  # N
    assert min(forces.before.min(), forces.after.min()) >= 0


def test_what_each_coordinate_gains_is_told() -> None:
    gain = planted()
    assert set(gain.explained) == {
        "lateral_shift_mm",
        "anterior_drawer_mm",
        "distraction_mm",
        "varus_deg",
        "internal_deg",
    }
    assert max(gain.explained.values()) > 0.5
    assert max(gain.explained.values()) <= 1


def test_the_summary_is_ready_for_a_file() -> None:
    gain = planted()
    found = plain(summary_of(gain_found(gain)))
    assert found["rmse_held_out_before"] == gain.rmse_held_out(gain.before).noise
    assert found["rmse_held_out_after"] == gain.rmse_held_out(gain.after).noise
    assert found["elpd_difference"] == gain.elpd.difference
    assert found["elpd_se"] == gain.elpd.se
    assert set(found["families"]) == set(FAMILIES)
    assert set(found["parameters"]) == {x.name for x in gain.parameters}
    assert found["families"][FLEXION]["folds"] == ["0 deg", "4 deg", "8 deg"]
    assert set(found["forces"]) == set(gain.forces.trials)


def test_a_cause_that_is_not_there_gains_nothing() -> None:
    gain = measure_gain(*fits(small_knee(), compression(), [0.0], seed=3), sds())
    assert gain.before.check.p_value > 0.01
    assert gain.elpd.difference < 2 * gain.elpd.se or np.isnan(gain.elpd.se)
    assert gain.log_evidence_difference < 2
    assert gain.rmse_held_out(gain.after).noise == pytest.approx(
        gain.rmse_held_out(gain.before).noise, rel=0.05
    )
    json.dumps(plain(summary_of(gain_found(gain))), allow_nan=False)


def test_where_the_knee_lies_in_the_scanner_does_not_matter() -> None:
    turn = Rotation.from_euler("xyz", [0.4, -0.8, 1.1]).as_matrix()
    knee = small_knee(rotation=turn, translation=np.array([30.0, -20.0, 50.0]))
    moved = measure_gain(*fits(knee, structure(knee), PLANTED), sds())
    # Fits end within a thousandth of a unit of deviance, folds within a hundredth.
    assert moved.elpd.difference == pytest.approx(planted().elpd.difference, rel=1e-2)
    assert moved.log_evidence_difference == pytest.approx(
        planted().log_evidence_difference, rel=1e-3
    )
