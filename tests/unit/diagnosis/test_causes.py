"""The causes of a fit in physical units."""

import math

from diagnoses import FRAME, FRAME_DEG, diagnosed

from identknee.diagnosis.causes import causes_of, explanation_of, ligament_estimates, unit_of
from identknee.model.effects.library import library
from identknee.subject.knee import Knee

UNITS = {"kN", "%", "mm", "deg", "N", "N·m", "N/mm", "N/N·m", "deg/N·m", "1"}


def test_every_amplitude_of_the_library_has_its_unit(reference: Knee) -> None:
    effects = library(reference, has_order=True, has_phase=True)
    units = {name: unit_of(name) for x in effects for name in x.parameters.names}
    assert set(units.values()) <= UNITS
    plain = {name.partition(".")[2] for name, unit in units.items() if unit == "1"}
    assert plain == {"gain", "ln_modulus", "exponent"}


def test_a_vector_is_as_large_as_its_components_together() -> None:
    (cause,) = causes_of(explanation_of(diagnosed(FRAME)))
    values = [x.value for x in cause.parameters]
    assert cause.name == FRAME
    assert (cause.amplitude.name, cause.amplitude.unit) == ("total", "deg")
    # Errors of the components only add to the length found.
    assert 0.98 * math.hypot(*values) < cause.amplitude.value < math.hypot(*values)
    low, high = cause.amplitude.ci95
    assert low < FRAME_DEG < high


def test_data_without_an_effect_have_no_causes() -> None:
    found = diagnosed(None)
    assert explanation_of(found) is found.base
    assert causes_of(explanation_of(found)) == ()


def test_every_ligament_has_both_parameters_within_their_intervals(reference: Knee) -> None:
    tree = ligament_estimates(diagnosed(None).base)
    assert list(tree) == [x.name for x in reference.ligaments]
    for own in tree.values():
        assert {x.unit for x in own.values()} == {"kN", "%"}
        assert all(x.ci95[0] < x.value < x.ci95[1] for x in own.values())
