"""The knees that come with identknee: their facts, their files, and what a name means."""

from pathlib import Path

import numpy as np
import pytest
from common.records import knee_digest

from identknee.runs.errors import InputError
from identknee.runs.files import digest
from identknee.runs.findings import Severity
from identknee.subject.check import check_geometry
from identknee.subject.examples import FOLDER, NAMED_SUBJECTS, known_names
from identknee.subject.folder import example, read_subject, write_subject
from identknee.subject.reference import reference_knee

FOUR = ("ACL", "PCL", "LCL", "MCL")
BUNDLES = (
    *("ACLam", "ACLpl", "PCLal", "PCLpm", "LCL", "MCLa", "MCLm", "MCLp"),
    *("dMCL", "POL", "ALS", "PCAPl", "PCAPm", "PFL"),
)
LENHART = ([29782, 4244, 4358], [6990.51, 1000.02, 1024.27])
DENVER = ([9850, 2965, 793], [4663.59, 877.59, 1041.33])
# Triangles and areas [mm2] of the STL files that the surfaces were made from; side and ligaments.
FACTS = {
    "lenhart2015": (*LENHART, "right", FOUR),
    "lenhart2015_stable": (*LENHART, "right", FOUR),
    "s192803": (*DENVER, "left", FOUR),
    "s192803_bundles": (*DENVER, "left", BUNDLES),
}
# Of the folders that these knees were before they came with identknee: recorded numbers hang on
# every bit, the order of the vertices included.
DIGESTS = {
    "lenhart2015": "68f3af8045e37df5382b77526f2ce6354d4797e73634a63de40d93704c722dfd",
    "lenhart2015_stable": "e9d4e4680b54709c97833f7bd99ea8b985bf854cd5dad1f3cc0f39061f54d2be",
}
# The same of places rounded to a nanometre.
ROUNDED = {
    "s192803": "5cc45d55362d4cec3a12533a8eb73b4bf7c3f035a426d05c61dab5f19872d71a",
    "s192803_bundles": "575ab07abab888da3fa2c58b5705d160162dc7200c7247db52fecb5d61a56c72",
}
WORDS = {
    "lenhart2015": ("Ann Biomed Eng 43(11):2675-2685", "Apache-2.0", "commit 73306a0f8dce"),
    "lenhart2015_stable": ("lenhart2015", "Apache-2.0"),
    "s192803": ("doi:10.5061/dryad.zkh1893gw", "CC0 1.0"),
}


def test_every_name_is_here() -> None:
    assert [x.name for x in NAMED_SUBJECTS] == ["reference", *FACTS]


@pytest.mark.parametrize("name", FACTS)
def test_a_named_subject_is_what_its_source_says(name: str) -> None:
    triangles, areas, side, ligaments = FACTS[name]
    knee = example(name)
    surfaces = (knee.femur, *knee.tibia)
    assert knee.name == name
    assert knee.side == side
    assert tuple(x.name for x in knee.ligaments) == ligaments
    assert [len(x.faces) for x in surfaces] == triangles
    assert [x.areas.sum() for x in surfaces] == pytest.approx(areas, abs=0.005)
    # A left knee is mirrored: lateral is where z of the tibia grows.
    medial, lateral = (knee.tibia_frame.to_local(x.centroid)[2] for x in knee.tibia)
    assert medial < 0.0 < lateral
    assert [x for x in check_geometry(knee) if x.severity is not Severity.INFO] == []


@pytest.mark.parametrize("name", ["lenhart2015", "lenhart2015_stable"])
def test_a_named_subject_is_the_folder_it_was_to_the_last_bit(name: str) -> None:
    assert knee_digest(example(name)) == DIGESTS[name]


@pytest.mark.parametrize("name", ["s192803", "s192803_bundles"])
def test_a_knee_turned_into_its_frames_is_the_folder_it_was_to_a_nanometre(name: str) -> None:
    """Frames from landmarks are computed: their last bits hang on the version of numpy."""
    knee = example(name)
    surfaces = [x.vertices for x in (knee.femur, *knee.tibia)]
    frames = [y for x in (knee.femur_frame, knee.tibia_frame) for y in (x.origin, x.axes)]
    insertions = [y for x in knee.ligaments for y in (x.femur, x.tibia)]
    # Moved aside, so that no written decimal lies where rounding changes its mind.
    whole = [np.round(x + 3.7e-7, 6) + 0.0 for x in (*surfaces, *frames, *insertions)]
    assert digest(b"".join(x.tobytes() for x in whole)) == ROUNDED[name]


@pytest.mark.parametrize("name", WORDS)
def test_source_and_licence_stand_beside_the_surfaces(name: str) -> None:
    page = (FOLDER / name / "README.md").read_text(encoding="utf-8")
    for words in WORDS[name]:
        assert words in page


@pytest.mark.parametrize("name", ["lenhart2015", "lenhart2015_stable"])
def test_the_licence_that_asks_for_it_is_given_in_full(name: str) -> None:
    text = (FOLDER / name / "LICENSE").read_text(encoding="utf-8")
    assert "Version 2.0, January 2004" in text
    assert "END OF TERMS AND CONDITIONS" in text


def test_all_subjects_name_source_and_licence() -> None:
    for subject in NAMED_SUBJECTS:
        assert subject.source
        assert subject.licence in ("Apache-2.0", "CC0-1.0")


def test_the_stable_knee_has_the_surfaces_of_the_raw_one() -> None:
    raw, stable = example("lenhart2015"), example("lenhart2015_stable")
    np.testing.assert_array_equal(raw.femur.vertices, stable.femur.vertices)
    # As the page beside it says.
    for bone, printed in (("femur", [10.4, 5.7, 9.0, 2.9]), ("tibia", [6.5, 7.9, 4.1, 2.4])):
        pairs = [(getattr(x, bone), getattr(stable.ligament(x.name), bone)) for x in raw.ligaments]
        moved = [np.linalg.norm(one - other) for one, other in pairs]
        assert moved == pytest.approx(printed, abs=0.051)


def test_reference_is_the_knee_of_formulas() -> None:
    assert knee_digest(example("reference")) == knee_digest(reference_knee())


def test_a_name_wins_over_a_folder_and_a_path_over_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = reference_knee(3.0, femur_edge_mm=3.0)
    write_subject(mine, tmp_path / "s192803")
    monkeypatch.chdir(tmp_path)
    assert read_subject("s192803").name == "s192803"
    for path in ("./s192803", "s192803/", "s192803/subject.toml", Path("s192803")):
        assert read_subject(path).name == "reference"


def test_a_mistyped_name_is_answered_with_the_list() -> None:
    said = (
        "Did you mean lenhart2015_stable? Named subjects are reference, lenhart2015, "
        "lenhart2015_stable, s192803, s192803_bundles."
    )
    assert known_names("lenhart2015_stabel") == said
    with pytest.raises(InputError, match="lenhart2015_stabel") as caught:
        read_subject("lenhart2015_stabel")
    assert caught.value.remedy.startswith(said)
    with pytest.raises(ValueError, match=r"'me'.*lenhart2015"):
        example("me")


def test_a_name_is_text() -> None:
    with pytest.raises(ValueError, match=r"named subject.*s192803"):
        example(Path("s192803"))  # type: ignore[arg-type]
