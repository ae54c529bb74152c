"""The page of shared facts is complete in its code and right in its numbers."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from identknee.blind import case, experiment, hidden
from identknee.blind.conditions import STANDARD
from identknee.model.parameters import ligament_parameters
from identknee.subject.folder import example
from identknee.subject.insertion_sites import structure_sites

PAGE = (Path(__file__).parent / "SHARED_FACTS.md").read_text(encoding="utf-8")


def test_every_module_that_the_generator_reaches_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parents[1] / "architecture"), *sys.path])
    imports = importlib.import_module("test_blind_imports")
    everything = imports._reached("blind")
    reached = {x for x in everything if imports._part(x) != "blind" and x.count(".") == 2}
    named: set[str] = set()
    for row in re.findall(r"^\| (`identknee.*?) \|", PAGE, re.MULTILINE):
        first, *others = re.findall(r"`([\w.]+)`", row)
        parent = first.rpartition(".")[0]
        named |= {first, *(f"{parent}{x}" for x in others)}
    assert named == reached


def test_the_numbers_are_those_of_the_code() -> None:
    prior = ligament_parameters(["any"], [10.0], [0.0]).prior_sd
    for told in (
        f"around the subject's with log-sd {STANDARD.stiffness_log_sd:g}",
        f"reference strain with sd {STANDARD.strain_sd_pct:g} %",
        f"at most {STANDARD.largest_shift_pct:g} %",
        f"prior with log-sd {prior[0]:g} and {prior[1]:g} %",
        f"{STANDARD.jitter_mm:g} mm of jitter",
        f"exponent {experiment.EXPONENT:g}, {experiment.MODULUS:g} N/mm3",
        f"stated up to {100.0 * (case.STATED_RANGE[1] - 1.0):.0f} % wrong",
    ):
        assert told in PAGE


@pytest.mark.parametrize("column", [0, 1])
def test_places_of_both_differ_as_the_table_says(column: int) -> None:
    """A generator that put structures where the library looks first would measure nothing."""
    knee = example(("reference", "lenhart2015_stable")[column])
    of_library = {x.name: x for lines in structure_sites(knee).values() for x in lines}
    apart: list[float] = []
    for name, (femur, tibia) in hidden.structure_insertions(hidden.anatomical_sites(knee)).items():
        place = of_library[name]
        ends = (
            float(np.linalg.norm(knee.femur_frame.to_local(place.femur) - femur)),
            float(np.linalg.norm(knee.tibia_frame.to_local(place.tibia) - tibia)),
        )
        row = next(x for x in PAGE.splitlines() if x.startswith(f"| {name} |"))
        told = [float(x) for x in row.split("|")[2 + column].split(",")]
        np.testing.assert_allclose(told, ends, atol=0.06)
        apart += ends
    assert np.sqrt(np.mean(np.square(apart))) > 4.0
