"""Blind cases: drawn by their seed, sized for a signal, and telling nothing of what they hide."""

from pathlib import Path

import numpy as np
import pytest
from posed_knees import NAMES, posed_reference
from slow_cases import some_slow

from identknee.blind.case import BlindCase, blind_case, write_blind
from identknee.blind.effects import EFFECTS, HISTORY, LISTED
from identknee.blind.experiment import TOE_STRAIN
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.table import read_laxity
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.mechanics.pose import pose_from_coordinates
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee

SIGNAL = 8.0
# The search stops within 2 % of the signal, and the last fit starts elsewhere.
SIGNAL_SHARE = 0.05


@pytest.fixture(scope="module")
def knee() -> Knee:
    return reference_knee(3.0)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    whole = load_protocol("seed63")
    is_large = np.abs(whole.loads).max(axis=1) % 4 == 2
    return whole.select(is_large & (whole.flexion_deg != 30.0))


@pytest.fixture(scope="module")
def null(knee: Knee, protocol: Protocol) -> BlindCase:
    return blind_case(knee, seed=1, effect=None, protocol=protocol)


def test_a_seed_gives_the_same_files(knee: Knee, protocol: Protocol, tmp_path: Path) -> None:
    for name in ("one", "two"):
        case = blind_case(knee, seed=5, effect="drift", protocol=protocol)
        write_blind(case, tmp_path / name)
    for file in ("laxity.csv", "truth.json"):
        first, second = ((tmp_path / x / file).read_bytes() for x in ("one", "two"))
        assert first == second
    read = read_laxity(tmp_path / "one" / "laxity.csv")
    np.testing.assert_array_equal(read.coordinates, case.laxity.coordinates)


def test_other_seeds_give_other_numbers(knee: Knee, protocol: Protocol, null: BlindCase) -> None:
    other = blind_case(knee, seed=2, effect=None, protocol=protocol)
    assert not (other.laxity.coordinates == null.laxity.coordinates).any()
    assert not set(other.truth.theta.values()) & set(null.truth.theta.values())


def test_a_null_hides_nothing_and_is_no_subject_as_given(knee: Knee, null: BlindCase) -> None:
    assert null.truth.effects == ()
    assert null.truth.signal == 0.0
    for x in knee.ligaments:
        assert null.truth.theta[f"{x.name}.stiffness_kN"] != x.stiffness_kN


def test_the_true_tensions_are_those_of_the_printed_law_at_the_true_poses(
    knee: Knee, protocol: Protocol, null: BlindCase
) -> None:
    theta = np.array(list(null.truth.theta.values()))
    poses = pose_from_coordinates(null.noise_free.coordinates)
    flexion = np.radians(protocol.flexion_deg)
    lines = LaxityModel(knee=knee, protocol=protocol).joint.lines
    found = ligament_tensions(lines, flexion, poses, 1000.0 * theta[:4], 0.01 * theta[4:])
    # The generator rounds the ends of the toe region by 2 % of its width.
    rounded = 0.02 * TOE_STRAIN * 1000.0 * theta[:4]
    assert (np.abs(null.tensions - found.tensions) < rounded).all()
    assert null.tensions.max() > 20.0 * rounded.max()


def test_the_noise_is_misstated_within_a_fifth_and_its_correlation_not_stated(
    null: BlindCase,
) -> None:
    laxity, facts = null.laxity, null.truth.facts
    assert laxity.sd is not None
    assert laxity.within_trial_correlation == 0.0
    assert facts["within_trial_correlation"] == 0.3
    stated = laxity.sd[0, [0, 4]] / 0.3
    assert ((stated >= 0.8) & (stated <= 1.2)).all()
    error = (laxity.coordinates - null.noise_free.coordinates).ravel()
    # Five errors of a trial share 0.3, so that they count as five over 2.2 independent ones.
    n_independent = error.size / 2.2
    assert error.std() == pytest.approx(0.3, rel=5.0 / np.sqrt(2.0 * n_independent))


@pytest.mark.parametrize(
    "effect", ["anterolateral", "moment_gain_IE", "compression", "femur_frame"]
)
def test_an_effect_is_sized_for_its_signal(knee: Knee, protocol: Protocol, effect: str) -> None:
    case = blind_case(knee, seed=3, effect=effect, signal=SIGNAL, protocol=protocol)
    assert case.truth.effects == (effect,)
    assert not case.truth.is_largest
    assert case.truth.signal == pytest.approx(SIGNAL, rel=SIGNAL_SHARE)


@pytest.mark.parametrize("effect", some_slow(sorted(EFFECTS), sorted(EFFECTS)[::2]))
def test_every_effect_changes_the_data(
    knee: Knee, protocol: Protocol, null: BlindCase, effect: str
) -> None:
    case = blind_case(knee, seed=1, effect=effect, signal=3.0, protocol=protocol)
    assert np.isfinite(case.laxity.coordinates).all()
    assert case.truth.signal > 0.05
    amplitude, unit = case.truth.amplitudes[effect]["amplitude"]
    assert amplitude != 0.0
    assert unit
    assert (effect in HISTORY) <= (case.laxity.order is not None)


def test_two_effects_are_both_there(knee: Knee, protocol: Protocol) -> None:
    pair = ("rig_compliance_IE", "drift")
    case = blind_case(knee, seed=3, effect=pair, signal=SIGNAL, protocol=protocol)
    assert case.truth.effects == pair
    assert case.truth.signal > SIGNAL


def test_random_effects_come_from_the_seed(knee: Knee, protocol: Protocol) -> None:
    protocol = protocol.select([0, 1, 2])
    drawn = {
        blind_case(knee, seed=seed, signal=2.0, protocol=protocol).truth.effects
        for seed in range(4)
    }
    assert len(drawn) > 1


@pytest.mark.slow
def test_any_knee_will_do() -> None:
    """One of other names, sides and places, whose femur is a mesh; a line is on its bones."""
    knee = posed_reference(4, side="right", edge_mm=3.0)
    short = load_protocol("seed63").select([0, 5, 10])
    case = blind_case(knee, seed=2, effect="anterolateral", protocol=short)
    assert f"{NAMES[0]}.stiffness_kN" in case.truth.theta
    femur, tibia = case.truth.lines["anterolateral"]
    lateral = max(knee.ligaments, key=lambda x: float(knee.femur_frame.to_local(x.femur)[2]))
    assert np.linalg.norm(femur - lateral.femur) < 25.0
    assert np.linalg.norm(tibia - lateral.tibia) < 45.0


def test_mistakes_of_the_caller(knee: Knee) -> None:
    with pytest.raises(ValueError, match="meniscus"):
        blind_case(knee, seed=1, effect="menicus")
    with pytest.raises(ValueError, match="twice"):
        blind_case(knee, seed=1, effect=("drift", "drift"))
    with pytest.raises(ValueError, match="greater than 0"):
        blind_case(knee, seed=1, signal=0.0)
    assert set(LISTED) <= set(EFFECTS)
