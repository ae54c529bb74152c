"""The causes of a fit in physical units."""

import math

import numpy as np
import pytest
from diagnoses import FRAME, FRAME_DEG, diagnosed

from identknee.diagnosis import verdict as causes
from identknee.diagnosis.verdict import (
    Cause,
    Estimate,
    ligament_estimates,
)
from identknee.model.effects.library import library
from identknee.report.answers.diagnose import size_words
from identknee.runs.words import unit_of
from identknee.subject.knee import Knee

UNITS = {"kN", "%", "mm", "deg", "N", "N·m", "N/mm", "N/mm3", "N/N·m", "deg/N·m", ""}


def test_every_amplitude_of_the_library_has_its_unit(reference: Knee) -> None:
    effects = library(reference, has_order=True, has_phase=True)
    units = {name: unit_of(name) for x in effects for name in x.parameters.names}
    assert set(units.values()) <= UNITS
    plain = {name.partition(".")[2] for name, unit in units.items() if not unit}
    assert plain == {"gain", "ln_modulus", "exponent"}


def test_a_vector_is_as_large_as_its_components_together() -> None:
    (cause,) = diagnosed(FRAME).causes
    values = [x.value for x in cause.parameters.values()]
    assert cause.name == FRAME
    assert (cause.parameter, cause.unit) == ("total", "deg")
    # Errors of the components only add to the length found.
    assert 0.98 * math.hypot(*values) < cause.amplitude < math.hypot(*values)
    low, high = cause.ci95
    assert low is not None
    assert high is not None
    assert low < FRAME_DEG < high


def test_data_without_an_effect_have_no_causes() -> None:
    found = diagnosed(None)
    assert found.explanation is found.base
    assert found.causes == ()


def test_every_ligament_has_both_parameters_within_their_intervals(reference: Knee) -> None:
    tree = ligament_estimates(diagnosed(None).base)
    assert list(tree) == [x.name for x in reference.ligaments]
    for own in tree.values():
        assert {x.unit for x in own.values()} == {"kN", "%"}
        for x in own.values():
            low, high = x.ci95
            assert low is not None
            assert high is not None
            assert low < x.value < high


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((1.0, 3.0), "2 mm (95 % from 1 to 3 mm)"),
        ((None, 3.0), "2 mm (95 % open below, up to 3 mm)"),
        ((1.0, None), "2 mm (95 % from 1 mm, open above)"),
        ((None, None), "2 mm (95 % open to both sides)"),
    ],
)
def test_an_open_end_is_said_and_not_printed_as_a_limit(
    ends: tuple[float | None, float | None], said: str
) -> None:
    cause = Cause(
        name=FRAME,
        amplitude=2.0,
        unit="mm",
        ci95=ends,
        parameter="shift_mm",
        parameters={},
        line=None,
    )
    assert size_words(cause) == said


def test_a_length_has_no_limit_where_a_component_has_none() -> None:
    known = Estimate(name="x_mm", value=3.0, unit="mm", ci95=(2.0, 4.0))
    held = Estimate(name="y_mm", value=4.0, unit="mm", ci95=(3.0, None))
    stopped = Estimate(name="y_mm", value=4.0, unit="mm", ci95=(None, None))
    spread = 0.01 * np.eye(2), np.full(2, 10.0)
    assert None not in causes._total((known, known), *spread).ci95
    low, high = causes._total((known, held), *spread).ci95
    assert low is not None
    assert high is None
    assert causes._total((known, stopped), *spread).ci95 == (None, None)
