"""Trials are read from whatever a verb is given."""

from pathlib import Path

import pytest

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, read_tests, read_trials
from identknee.laxity.trial_words import laxity_groups
from identknee.runs.errors import InputError

TABLE = "trial,flexion_deg,varus_moment_Nm,varus_deg\na,30,5,\nb,30,-5,\n"


def test_a_protocol_is_what_it_is() -> None:
    given = load_protocol("drawer")
    assert read_tests(given) is given
    assert read_trials("drawer").trials == given.trials


def test_the_trials_of_a_table_need_no_measured_value(tmp_path: Path) -> None:
    path = tmp_path / "planned.csv"
    path.write_text(TABLE, encoding="utf-8")
    tests = read_tests(path)
    assert isinstance(tests, Laxity)
    assert read_trials(str(path)).trials == ("a", "b")


def test_a_measured_table_has_its_name() -> None:
    assert read_trials("s192803").n == 25


@pytest.mark.parametrize(
    ("word", "said"),
    [("seed64", "Did you mean seed63?"), ("s19280", "Did you mean s192803?")],
)
def test_a_word_that_names_nothing_is_answered_with_the_closest(word: str, said: str) -> None:
    with pytest.raises(InputError, match="there is no protocol and no file of this name") as caught:
        read_trials(word)
    assert said in str(caught.value)


def test_groups_of_a_measured_table_have_nominal_angles_and_no_stray_loads() -> None:
    groups = laxity_groups(read_trials("s192803"))
    assert {x.flexion_deg for x in groups} == {5.0, 36.0, 57.0, 87.0}
    assert not any("+" in x.load for x in groups)
