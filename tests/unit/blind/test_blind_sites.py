"""Where the generator puts structures, by what anatomists say; and sizes for a wanted signal."""

import numpy as np
import pytest
from blind_scene import scene
from posed_knees import posed_reference

from identknee.blind.case import Noise, amplitude_for_signal, unexplained_norm
from identknee.blind.hidden import anatomical_sites, structure_insertions
from identknee.runs.declare import Array
from identknee.subject.reference import reference_knee

NOISE = Noise(sd_mm=0.3, sd_deg=0.3, correlation=0.3)
ENDS = structure_insertions(scene().places)
MEDIAL, LATERAL = scene().places.epicondyles


def from_collateral(name: str, epicondyle: Array) -> Array:
    """Anterior, superior and lateral distance of a femoral end from the collateral's [mm]."""
    return np.asarray(ENDS[name][0] - epicondyle)


def test_the_anterolateral_ligament_starts_behind_and_above_the_lateral_collateral() -> None:
    """By some 5 mm, and ends in front of the fibula, below the joint line (Kennedy 2015)."""
    anterior, superior, _ = from_collateral("anterolateral", LATERAL)
    assert anterior < 0.0 < superior
    assert np.hypot(anterior, superior) == pytest.approx(5.0, abs=2.0)
    tibia, places = ENDS["anterolateral"][1], scene().places
    assert tibia[0] > places.fibula[0] + 10.0
    assert -12.0 < tibia[1] - places.plateaus[1, 1, 1] < -5.0
    assert tibia[2] > places.plateaus[1, 1, 2]


def test_the_popliteofibular_ligament_starts_in_front_of_and_below_the_lateral_collateral() -> None:
    """And ends behind and above where that ends on the fibula (LaPrade 2003)."""
    anterior, superior, _ = from_collateral("popliteofibular", LATERAL)
    assert anterior > 0.0 > superior
    down = ENDS["popliteofibular"][1] - scene().places.fibula
    assert down[0] < 0.0 < down[1]


def test_the_posteromedial_structure_runs_behind_the_medial_collateral() -> None:
    """To the rear of the medial plateau (LaPrade 2007)."""
    assert from_collateral("posteromedial", MEDIAL)[0] == pytest.approx(-8.0, abs=3.0)
    tibia = ENDS["posteromedial"][1]
    assert tibia[0] < scene().places.plateaus[0, 1, 0] - 10.0
    assert tibia[2] < 0.0


def test_the_deep_medial_collateral_is_short_and_under_the_superficial_one() -> None:
    femur, tibia = ENDS["deep_mcl"]
    assert femur[1] < MEDIAL[1]
    assert tibia[1] < scene().places.plateaus[0, 1, 1]
    in_scan = tibia + scene().start[1]
    assert np.linalg.norm(femur - in_scan) < 45.0


def test_the_capsule_is_behind_both_condyles() -> None:
    for side, sign in (("medial", -1.0), ("lateral", 1.0)):
        femur, tibia = ENDS[f"posterior_capsule_{side}"]
        assert femur[0] < scene().places.femur[0, 0]
        assert tibia[0] < scene().places.plateaus[:, 1, 0].min() - 10.0
        assert sign * femur[2] > 0.0 < sign * tibia[2]


def test_places_grow_with_the_knee() -> None:
    """Distances are those of a knee whose epicondyles are 83 mm apart."""
    assert scene().places.scale == 1.0
    places = anatomical_sites(reference_knee())
    across = places.epicondyles[1, 2] - places.epicondyles[0, 2]
    assert places.scale == pytest.approx(across / 83.0)


def test_ligaments_are_told_by_where_they_run_and_not_by_their_names() -> None:
    """Medial and lateral collateral, anterior and posterior cruciate, on a renamed, posed knee."""
    knee, posed = reference_knee(), posed_reference(4)
    names = [x.name for x in knee.ligaments]
    for of in (knee, posed):
        found = anatomical_sites(of)
        order = [names[i] for i in (found.medial, found.lateral, found.front, found.rear)]
        assert order == ["MCL", "LCL", "ACL", "PCL"]


# --- sizes --------------------------------------------------------------------------------------


def test_what_is_left_is_what_no_slope_can_absorb() -> None:
    """Of a linear model: the length of the whitened change less its projection."""
    generator = np.random.default_rng(1)
    slopes, change = generator.normal(size=(6, 5, 3)), generator.normal(size=(6, 5))
    covariance = np.kron(np.eye(6), 0.09 * (0.3 + 0.7 * np.eye(5)))
    inverse = np.linalg.inv(covariance)
    columns, whole = slopes.reshape(30, 3), change.ravel()
    best = np.linalg.solve(columns.T @ inverse @ columns, columns.T @ inverse @ whole)
    rest = whole - columns @ best
    assert unexplained_norm(slopes, change, NOISE) == pytest.approx(np.sqrt(rest @ inverse @ rest))
    assert unexplained_norm(slopes, slopes @ [1.0, -2.0, 0.5], NOISE) == pytest.approx(
        0.0, abs=1e-9
    )


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_an_amplitude_is_found_for_a_signal(power: float) -> None:
    """The signal grows with a power of the amplitude; the search ends within two percent."""

    def signal(amplitude: float) -> float:
        return float(4.0 * amplitude**power)

    found = amplitude_for_signal(signal, signal, 12.0, 50.0)
    assert found is not None
    assert not found.is_largest
    assert found.signal == pytest.approx(12.0, rel=0.02)
    assert found.amplitude == pytest.approx(3.0 ** (1.0 / power), rel=0.05)


def test_a_signal_out_of_reach_ends_at_the_largest_amplitude_and_says_so() -> None:
    found = amplitude_for_signal(lambda a: 2.0 * a, lambda a: 2.0 * a, 12.0, 3.0)
    assert found is not None
    assert found.is_largest
    assert (found.amplitude, found.signal) == (3.0, 6.0)
    assert amplitude_for_signal(lambda _: None, lambda _: None, 12.0, 3.0) is None
