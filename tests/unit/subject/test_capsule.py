"""Sheets of the capsule as ligaments of a knee."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.model.effects.library import library
from identknee.model.laxity_model import LaxityModel
from identknee.subject.capsule import LOG_STIFFNESS_SD, SHEETS, STRAIN_SD

GROUPS = {"posteromedial": "PMC", "posterolateral": "PLC", "anterolateral": "ALC"}


@pytest.fixture(scope="module")
def knee() -> ik.Knee:
    return ik.subject.with_capsule(ik.reference_knee())


def test_each_sheet_has_one_stiffness_and_one_strain(knee: ik.Knee) -> None:
    model = LaxityModel(knee=knee, protocol=ik.load_protocol("drawer"))
    p = model.parameters
    assert p.n == 14
    for name, group in GROUPS.items():
        i, j = (p.index(f"{group}.{x}") for x in ("stiffness_kN", "reference_strain_pct"))
        assert p.start[i] == pytest.approx(SHEETS[name].stiffness_kN)
        assert p.is_log[i]
        assert (p.prior_sd[i], p.prior_sd[j]) == (LOG_STIFFNESS_SD, STRAIN_SD)


def test_sheets_lie_where_their_names_say(knee: ik.Knee) -> None:
    """Behind, in front of, and on the sides of the middle of the plateaus, from bone to bone."""
    for bone, frame in (("femur", knee.femur_frame), ("tibia", knee.tibia_frame)):
        for group, side, front in (("PMC", -1.0, -1.0), ("PLC", 1.0, -1.0), ("ALC", 1.0, 0.0)):
            members = [x for x in knee.ligaments if x.name.startswith(group)]
            assert len(members) == 3
            places = frame.to_local(np.array([getattr(x, bone) for x in members]))
            assert (np.sign(places[:, 2]) == side).all()
            if front and bone == "tibia":
                assert (np.sign(places[:, 0]) == front).all()
            spacing = np.linalg.norm(np.diff(places, axis=0), axis=1)
            assert ((spacing > 2.0) & (spacing < 15.0)).all()
            assert all(25.0 < x.length < 65.0 for x in members)


def test_it_is_read_from_a_subject_file_and_written_as_ligaments(tmp_path: Path) -> None:
    plain = ik.example("s192803")  # a left knee
    folder = ik.write_subject(plain, tmp_path / "knee")
    file = folder / "subject.toml"
    text = file.read_text()
    file.write_text(text.replace("[surfaces]", 'capsule = ["posteromedial"]\n\n[surfaces]', 1))
    read = ik.read_subject(folder)
    made = ik.subject.with_capsule(plain, ["posteromedial"])
    assert [x.name for x in read.ligaments] == [x.name for x in made.ligaments]
    for one, other in zip(read.ligaments, made.ligaments, strict=True):
        np.testing.assert_allclose(one.femur, other.femur, atol=1e-3)
        np.testing.assert_allclose(one.tibia, other.tibia, atol=1e-3)
    again = ik.read_subject(ik.write_subject(read, tmp_path / "again"))
    np.testing.assert_array_equal(again.ligaments[-1].femur, read.ligaments[-1].femur)
    assert again.groups == read.groups
    file.write_text(text.replace("[surfaces]", 'capsule = ["medial"]\n\n[surfaces]', 1))
    with pytest.raises(ik.InputError, match=r"key capsule.*'medial'"):
        ik.read_subject(folder)


def test_names_that_are_taken_are_refused(knee: ik.Knee) -> None:
    with pytest.raises(ValueError, match="called ALC"):
        ik.subject.with_capsule(knee, ["anterolateral"])


def test_a_structure_that_sheets_cover_is_no_cause() -> None:
    knee = ik.reference_knee()
    names = {x.name for x in library(knee)}
    structures = ("anterolateral", "posteromedial", "posterior_capsule")
    assert names.issuperset(structures)
    for sheets, left in (
        (["anterolateral"], {"posteromedial", "posterior_capsule"}),
        (["posterolateral"], set(structures)),
        (list(GROUPS), set()),
    ):
        causes = {x.name for x in library(ik.subject.with_capsule(knee, sheets))}
        assert causes.intersection(structures) == left


def test_a_capsule_holds_a_knee_whose_cruciate_is_cut(knee: ik.Knee) -> None:
    protocol = ik.load_protocol("table2")
    cut = replace(protocol, state=("cut: ACL",) * protocol.n)
    held = [
        LaxityModel(knee=x, protocol=cut).predict(y).is_converged.sum()
        for x, y in (
            (own, LaxityModel(knee=own, protocol=cut).parameters.start)
            for own in (ik.reference_knee(), knee)
        )
    ]
    assert held[1] > held[0]
