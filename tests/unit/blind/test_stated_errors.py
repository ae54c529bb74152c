"""Geometry and loads drawn as wrong as they are stated to be: sizes, signs and what stays."""

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

from identknee.blind.conditions import (
    STANDARD,
    Conditions,
    LoadErrors,
    knee_with_errors,
    load_errors,
    stated_conditions,
    with_load_errors,
)
from identknee.blind.experiment import experiment_of
from identknee.subject.knee import Knee

N = 200


def drawn(conditions: Conditions) -> list[Knee]:
    generator = np.random.default_rng(0)
    return [knee_with_errors(small_knee(), conditions, generator) for _ in range(N)]


def off(conditions: Conditions) -> LoadErrors:
    return load_errors(conditions, np.random.default_rng(1))


def test_insertions_err_by_the_stated_size_along_every_axis_of_their_bone() -> None:
    knee = small_knee()
    shifts = np.array(
        [
            [knee.femur_frame.to_local(x.femur) for x in other.ligaments]
            for other in drawn(Conditions(insertion_mm=2.0))
        ]
    ) - [knee.femur_frame.to_local(x.femur) for x in knee.ligaments]
    sd = shifts.reshape(-1, 3).std(axis=0)
    # Relative standard error of a standard deviation of k draws: 1 / sqrt(2 k); 4 of them.
    assert sd == pytest.approx(2.0, rel=4.0 / np.sqrt(2 * N * len(knee.ligaments)))


def test_frames_turn_and_shift_by_the_stated_size() -> None:
    knee = small_knee()
    others = drawn(Conditions(registration_deg=2.0, registration_mm=3.0))
    turns = np.array([x.tibia_frame.axes @ knee.tibia_frame.axes.T for x in others])
    angles = np.degrees([[t[1, 2], t[2, 0], t[0, 1]] for t in turns])
    shifts = np.array([knee.tibia_frame.to_local(x.tibia_frame.origin) for x in others])
    tolerance = 4.0 / np.sqrt(2 * N)
    assert angles.std(axis=0) == pytest.approx(2.0, rel=tolerance)
    assert shifts.std(axis=0) == pytest.approx(3.0, rel=tolerance)
    assert others[0].ligaments[0].length == pytest.approx(knee.ligaments[0].length)


def test_loads_keep_their_size_where_only_their_axes_turn() -> None:
    experiment = experiment_of(small_knee(), small_protocol())
    turned = with_load_errors(experiment, off(Conditions(load_axes_deg=3.0)))
    before, after = (np.linalg.norm(x.loads[:, 2:], axis=1) for x in (experiment, turned))
    np.testing.assert_allclose(after, before, rtol=1e-12)
    scaled = with_load_errors(experiment, off(Conditions(load_gain=0.1)))
    has_load = experiment.loads != 0.0
    ratios = np.where(has_load, scaled.loads / np.where(has_load, experiment.loads, 1.0), np.nan)
    assert np.nanmax(np.nanstd(ratios, axis=0)) < 1e-12


def test_the_standard_conditions_have_no_such_errors() -> None:
    assert not STANDARD.has_stated_errors
    assert Conditions(insertion_mm=1.0).has_stated_errors


def test_what_can_be_stated_is_drawn_and_what_cannot_is_refused() -> None:
    made = stated_conditions("insertions=2mm,registration=1deg,load_gain=3%,zero=0.2mm")
    sizes = (made.insertion_mm, made.registration_deg, made.load_gain, made.remount_mm)
    assert sizes == (2.0, 1.0, 0.03, 0.2)
    assert (made.registration_mm, made.load_axes_deg, made.remount_deg) == (0.0, 0.0, 0.0)
    assert not stated_conditions(None).has_stated_errors
    with pytest.raises(ValueError, match="contact_modulus"):
        stated_conditions("contact_modulus=0.3")
