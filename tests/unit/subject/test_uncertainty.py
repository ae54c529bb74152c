"""What a subject states of its uncertainty: read, written, overridden and refused."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_knee import small_knee

from identknee.runs.errors import InputError
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import EXACTLY, StatedPrior, Uncertainty, with_stated_uncertainty
from identknee.verbs.verb import knee_digest

TILTED = ((4.0, 1.0, 0.0), (1.0, 2.0, 0.0), (0.0, 0.0, 1.0))


def test_a_subject_keeps_what_it_states(tmp_path: Path) -> None:
    stated = Uncertainty(
        insertions_mm={"front": {"femur": 2.0, "tibia": TILTED}},
        registration_deg=2.0,
        load_gain=0.03,
    )
    knee = replace(
        small_knee(),
        uncertainty=stated,
        priors={"front.stiffness_kN": StatedPrior(log_sd=0.5, center=8.0)},
        bounds={"inner.reference_strain_pct": (-40.0, 40.0)},
    )
    again = read_subject(write_subject(knee, tmp_path / "knee"))
    assert again.uncertainty == stated
    assert again.priors == knee.priors
    assert again.bounds == knee.bounds
    assert knee_digest(again) == knee_digest(knee) != knee_digest(small_knee())


def test_an_insertion_has_the_covariance_stated_for_it() -> None:
    stated = Uncertainty(insertions_mm={"front": {"femur": 2.0, "tibia": TILTED}})
    np.testing.assert_array_equal(stated.insertion_covariance("front", "femur"), 4.0 * np.eye(3))
    np.testing.assert_array_equal(stated.insertion_covariance("front", "tibia"), TILTED)
    assert not stated.insertion_covariance("back", "femur").any()


def test_options_override_part_by_part() -> None:
    own = Uncertainty(insertions_mm=4.0, load_gain=0.1)
    stated = with_stated_uncertainty(own, ["insertions=2mm,registration=2deg", "registration=3mm"])
    assert stated == replace(own, insertions_mm=2.0, registration_deg=2.0, registration_mm=3.0)
    assert with_stated_uncertainty(own, "none,load_gain=3%") == Uncertainty(load_gain=0.03)
    assert with_stated_uncertainty(own, {"zero_mm": 0.3}) == replace(own, zero_mm=0.3)
    assert with_stated_uncertainty(own, None) is with_stated_uncertainty(own, []) is own


def test_every_part_is_told_as_uncertain_or_exact() -> None:
    stated = Uncertainty(insertions_mm=2.0, load_gain=0.03)
    uncertain, _, exact = stated.sentence.partition("As exact:")
    assert re.findall(r"(\w+) \((.+?)\)", uncertain) == [("insertions", "2 mm"), ("gain", "3 %")]
    assert "contact modulus" in exact
    assert stated.words["flexion_deg"] == "exact"
    assert EXACTLY.is_exact
    assert "--uncertain" in EXACTLY.sentence


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("insertion=2mm", "no such part.*insertions"),
        ("insertions=2deg", "insertions is stated in mm"),
        ("insertions", "not NAME=SIZE"),
        ("insertions=twomm", "not NAME=SIZE"),
        ("load_gain=3mm", "load_gain has no unit"),
        ("flexion=40deg", "0 to 20 deg, got 40"),
        ("flexion=-1deg", "0 to 20 deg, got -1"),
        ("", "is empty"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_remedy(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        with_stated_uncertainty(EXACTLY, text)


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ("[uncertainty]\ninsertion_mm = 2.0", "insertion_mm"),
        ("[uncertainty]\ninsertions_mm = -2.0", "standard deviation of 0 to 25 mm"),
        ("[uncertainty.insertions_mm.XYZ]\nfemur = 2.0", "does not have"),
        ('[priors."front.stiffness_kN"]\nsd = 1.0\nlog_sd = 0.3', "either sd or log_sd"),
        ("[bounds]\n'front.stiffness_kN' = [1.0]", "lower, upper"),
    ],
)
def test_a_mistake_in_the_file_names_its_place(lines: str, why: str, tmp_path: Path) -> None:
    folder = write_subject(small_knee(), tmp_path / "knee")
    file = folder / "subject.toml"
    file.write_text(f"{file.read_text(encoding='utf-8')}\n{lines}\n", encoding="utf-8")
    with pytest.raises(InputError, match=why):
        read_subject(folder)
