from pathlib import Path

import numpy as np
import pytest
from problems import IG2, IG4, LIGAMENTS, REFERENCE

from identknee.calibrate.fit import load_start, named_start, read_start, start_names
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.runs.errors import InputError

KNEE = ligament_parameters(LIGAMENTS, [11.0, 12.0, 13.0, 14.0], [1.0, 2.0, 3.0, 5.0])


def test_table_1_of_the_paper() -> None:
    ig3 = [9.0, 17.0, 7.0, 7.0, 7.0, -3.0, 4.0, 5.0]
    expected = {"IG1": REFERENCE, "IG2": IG2, "IG3": ig3, "IG4": IG4}
    assert start_names() == ("subject", *expected)
    for name, theta in expected.items():
        np.testing.assert_array_equal(named_start(name, KNEE), theta)


def test_mean_distances_of_table_1() -> None:
    # As printed in its last columns, to one decimal; 3.575 kN and 3.5 % for IG4.
    for name, k, strain in (("IG2", 0.5, 0.5), ("IG3", 1.1, 1.3), ("IG4", 3.6, 3.5)):
        off = np.abs(named_start(name, KNEE) - REFERENCE)
        assert abs(off[:4].mean() - k) <= 0.051
        assert abs(off[4:].mean() - strain) <= 0.051


def test_the_subjects_own_values() -> None:
    np.testing.assert_array_equal(named_start("subject", KNEE), KNEE.center)


def test_order_and_further_ligaments_do_not_matter() -> None:
    names = ["MCL", "popliteofibular", "LCL", "PCL", "ACL"]
    knee = ligament_parameters(names, [1.0, 2.5, 3.0, 4.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0])
    start = named_start("IG1", knee)
    assert start[knee.index("ACL.stiffness_kN")] == 10.0
    assert start[knee.index("MCL.reference_strain_pct")] == 4.0
    assert start[knee.index("popliteofibular.stiffness_kN")] == 2.5
    assert start[knee.index("popliteofibular.reference_strain_pct")] == 2.0


def test_a_knee_without_the_four_is_told_what_is_missing() -> None:
    knee = ligament_parameters(["front", "ACL", "MCL"], [1.0] * 3, [0.0] * 3)
    with pytest.raises(ValueError, match=r"IG1.*PCL.*LCL") as error:
        named_start("IG1", knee)
    assert "[front]\nstiffness_kN = 9.5" in str(error.value)


def test_an_unknown_name_is_told_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'IG5'.*subject.*IG1.*\.toml"):
        named_start("IG5", KNEE)
    for name, meant in (("ig4", "IG4"), ("Subject", "subject"), ("subjct", "subject")):
        with pytest.raises(ValueError, match=f"did you mean {meant}\\? The starts are"):
            named_start(name, KNEE)
    with pytest.raises(ValueError, match="'zz'; the starts are"):
        named_start("zz", KNEE)


def written(folder: Path, text: str) -> Path:
    path = folder / "start.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_sets_what_it_names(tmp_path: Path) -> None:
    path = written(
        tmp_path, "[ACL]\nstiffness_kN = 9.5\n[MCL]\nstiffness_kN = 8\nreference_strain_pct = -1\n"
    )
    start = load_start(path, KNEE)
    np.testing.assert_array_equal(start, [9.5, 12.0, 13.0, 8.0, 1.0, 2.0, 3.0, -1.0])
    np.testing.assert_array_equal(load_start(str(path), KNEE), start)
    np.testing.assert_array_equal(load_start("IG2", KNEE), IG2)


def test_a_file_may_name_parameters_that_are_no_ligaments(tmp_path: Path) -> None:
    parameters = Parameters(
        names=("toe.strain", "gain"),
        center=np.array([0.03, 1.0]),
        lower=np.array([0.0, 0.5]),
        upper=np.array([0.1, 2.0]),
        prior_sd=np.array([0.01, 0.1]),
        is_log=np.array([False, True]),
    )
    path = written(tmp_path, "gain = 1.5\n[toe]\nstrain = 0.02\n")
    np.testing.assert_array_equal(read_start(path, parameters), [0.02, 1.5])
    with pytest.raises(InputError, match=r"gain: 5 .*0\.5 to 2"):
        read_start(written(tmp_path, "gain = 5"), parameters)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[ACLL]\nstiffness_kN = 9", r"ACLL.stiffness_kN: .* Did you mean ACL.stiffness_kN\?"),
        ("[ACL]\nstiffness_kN = 9500", "9500 kN is out of bounds. Give a number from 0 to 40 kN"),
        ("[ACL]\nstiffness_kN = -1", "-1 kN is out of bounds"),
        ("[ACL]\nreference_strain_pct = 20", "20 % is out of bounds. .* from -15 to 15 %"),
        ("[ACL]\nstiffness_kN = nan", "nan is not a finite number"),
        ("[ACL]\nstiffness_kN = 'nine'", "'nine' is not a finite number"),
        ("[ACL]\nstiffness_kN = true", "True is not a finite number"),
        ("ACL: 9", "this is not TOML"),
        ("ACL = 9", "ACL: there is no such parameter"),
        ("", "the file is empty"),
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a" + ".a" * 5000 + " = 1", "there is no such parameter"),
        ("[ACL]\nstiffness_kN = 1" + "0" * 4000, "is not a finite number"),
        ("[ACL]\nstiffness_kN = 1" + "0" * 5000, "this is not TOML"),
        ("[ACL]\nstiffness_kN = 0x" + "f" * 5000, "is not a finite number"),
        ("a = 2000-02-31", "this is not TOML"),
    ],
)
def test_bad_files_are_named_with_place_and_remedy(
    tmp_path: Path, text: str, sentence: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=sentence) as error:
        read_start(path, KNEE)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml.*such"):
        load_start(tmp_path / "none.toml", KNEE)
