"""Menisci of a subject: what its file says, and what it may not say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.model.effects.library import library
from identknee.model.laxity_model import LaxityModel, meniscus_geometry
from identknee.runs.errors import ValueRefused
from identknee.subject.menisci import LOG_STIFFNESS_SD, MENISCI, STIFFNESS
from identknee.subject.surface import Surface

MEDIAL, LATERAL = (f"meniscal_wedge.{x}_stiffness_N_per_mm3" for x in ("medial", "lateral"))


def with_text(folder: Path, text: str) -> Path:
    """The folder with a text before its surfaces."""
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace("[surfaces]", f"{text}\n\n[surfaces]", 1))
    return folder


def test_stiffnesses_are_parameters_with_priors_and_the_offset_is_stated() -> None:
    knee = ik.subject.with_menisci(
        ik.reference_knee(), lateral_stiffness_N_per_mm3=2.0, offset_mm=0.2
    )
    p = LaxityModel(knee=knee, protocol=ik.load_protocol("drawer")).parameters
    assert p.names[8:] == (MEDIAL, LATERAL)
    np.testing.assert_array_equal(p.start[8:], [STIFFNESS, 2.0])
    np.testing.assert_array_equal(p.center[8:], [STIFFNESS, 2.0])
    np.testing.assert_array_equal(p.prior_sd[8:], LOG_STIFFNESS_SD)
    assert p.is_log[8:].all()
    assert knee.effects[0].values["offset_mm"] == 0.2


def test_a_removed_meniscus_stays_removed() -> None:
    knee = ik.subject.with_menisci(ik.reference_knee(), medial_stiffness_N_per_mm3=0.0)
    model = LaxityModel(knee=knee, protocol=ik.load_protocol("drawer"))
    assert model.parameters.names[8:] == (LATERAL,)
    found = model.predict(np.array(model.parameters.start), derivatives=False)
    assert (found.menisci[:, 0, 0] == 0.0).all()
    assert (found.menisci[:, 1, 0] > 0.0).any()


def test_they_are_read_from_a_subject_file_and_written_as_an_effect(tmp_path: Path) -> None:
    plain = ik.example("s192803")  # a left knee
    folder = ik.write_subject(plain, tmp_path / "knee")
    read = ik.read_subject(with_text(folder, "[menisci]\nmedial_stiffness_N_per_mm3 = 1.5"))
    assert dict(read.effects[0].values) == {
        "medial_stiffness_N_per_mm3": 1.5,
        "lateral_stiffness_N_per_mm3": STIFFNESS,
        "offset_mm": 0.0,
    }
    again = ik.read_subject(ik.write_subject(read, tmp_path / "again"))
    assert again.effects[0].values == read.effects[0].values
    assert again.effects[0].fixed == ("offset_mm",)
    assert dict(again.priors) == dict(read.priors)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[menisci]\nmedial_stiffness_N_per_mm3 = -1.0",
            r"\[menisci\].*medial meniscus.*0 to 5 N/mm3",
        ),
        (
            "[menisci]\nmiddle_stiffness_N_per_mm3 = 1.0",
            r"middle_stiffness_N_per_mm3.*medial_stiffness_N_per_mm3",
        ),
        ("[menisci]\noffset_mm = 2.5", r"\[menisci\].*-2 to 2 mm.*distance.*2\.5"),
        ("menisci = 1.0", r"menisci.*is not a table.*\[menisci\]"),
    ],
)
def test_wrong_input_is_answered_by_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    folder = ik.write_subject(ik.reference_knee(), tmp_path / "knee")
    with pytest.raises(ik.InputError, match=message) as error:
        ik.read_subject(with_text(folder, text))
    assert str(error.value).endswith((".", "?"))
    assert "\n" not in str(error.value)


def test_menisci_are_stated_once_with_a_stiffness() -> None:
    knee = ik.subject.with_menisci(ik.reference_knee())
    with pytest.raises(ValueError, match="menisci already"):
        ik.subject.with_menisci(knee)
    for value in (np.nan, np.inf, -0.1, 6.0):
        with pytest.raises(ValueError, match="lateral meniscus"):
            ik.subject.with_menisci(ik.reference_knee(), lateral_stiffness_N_per_mm3=value)


def test_a_closed_plateau_has_no_place_for_a_meniscus() -> None:
    """It is refused where one is stated, and no cause for `diagnose`."""
    knee = ik.reference_knee()
    medial, lateral = knee.tibia
    ball = Surface(
        vertices=medial.vertices[:4] + 3.0 * np.eye(4, 3),
        faces=np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
    )
    closed = replace(knee, tibia=(ball, lateral))
    with pytest.raises(ValueRefused, match="closed") as caught:
        ik.subject.with_menisci(closed)
    assert "medial plateau" in caught.value.why
    assert caught.value.remedy.endswith(" medial_stiffness_N_per_mm3 = 0.0")
    made = ik.subject.with_menisci(closed, medial_stiffness_N_per_mm3=0.0)
    assert set(meniscus_geometry(made).side.tolist()) == {1}
    assert MENISCI in {x.name for x in library(knee)}
    assert MENISCI not in {x.name for x in library(closed)}
    whole = meniscus_geometry(replace(knee, tibia=(ball, ball)))
    assert not len(whole.points)
