"""Groups of ligaments: what they may name, and that they come back from a folder."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_knee import small_knee

from identknee.runs.errors import InputError
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import KnownPose
from identknee.subject.ligament import LigamentGroup
from identknee.verbs.verb import knee_digest

FRONT = LigamentGroup(name="cruciates", members=("front", "back"))


def test_groups_poses_and_fitted_values_come_back(tmp_path: Path) -> None:
    pose = KnownPose(flexion_deg=30.0, coordinates=np.array([1.0, -2.0, 0.1, 0.3, -9.0]))
    fitted = {"cruciates.stiffness_kN": 7.25, "registration.femur_x_deg": -0.1}
    knee = replace(small_knee(), groups=(FRONT,), poses=(pose,), fitted=fitted)
    back = read_subject(write_subject(knee, tmp_path))
    assert back.groups == (FRONT,)
    assert dict(back.fitted) == fitted
    assert [x.coordinates.tolist() for x in back.poses] == [pose.coordinates.tolist()]
    assert knee_digest(back) == knee_digest(knee) != knee_digest(small_knee())
    write_subject(small_knee(), tmp_path)
    assert not read_subject(tmp_path).fitted


@pytest.mark.parametrize(
    ("groups", "said"),
    [
        (
            [LigamentGroup(name="front", members=("back", "outer"))],
            "another group is also called front",
        ),
        ([LigamentGroup(name="a", members=("back", "outr"))], "'outr', which the knee does not"),
        ([FRONT, LigamentGroup(name="b", members=("back", "outer"))], "back is in two groups"),
    ],
)
def test_groups_that_the_ligaments_do_not_allow(groups: list[LigamentGroup], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(small_knee(), groups=tuple(groups))


def test_a_group_of_one_and_one_without_stiffness() -> None:
    with pytest.raises(ValueError, match=r"ligaments.*front"):
        LigamentGroup(name="a", members=("front",))
    knee = small_knee()
    weak = tuple(replace(x, stiffness_kN=0.0) for x in knee.ligaments)
    with pytest.raises(ValueError, match=f"{FRONT.name} .*stiffness"):
        replace(knee, ligaments=weak, groups=(FRONT,))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[groups]]\nname = "a"\nmembers = ["front"]\n', "group a: the group a must name two"),
        ('[[groups]]\nname = "a"\nmembers = 3\n', "group a, key members: 3 is not a list"),
        ("[[poses]]\nflexion_deg = 3\ncoordinates = [1, 2]\n", "five numbers are wanted"),
    ],
)
def test_mistakes_in_the_file(tmp_path: Path, text: str, said: str) -> None:
    write_subject(small_knee(), tmp_path)
    file = tmp_path / "subject.toml"
    file.write_text(file.read_text() + "\n" + text)
    with pytest.raises(InputError, match=said):
        read_subject(tmp_path)


def test_a_fitted_value_that_is_no_number(tmp_path: Path) -> None:
    write_subject(replace(small_knee(), fitted={"front.stiffness_kN": 3.0}), tmp_path)
    (tmp_path / "fitted.toml").write_text('[front]\nstiffness_kN = "much"\n')
    with pytest.raises(InputError, match=r"front\.stiffness_kN.*number"):
        read_subject(tmp_path)
