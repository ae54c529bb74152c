"""What is told to someone who typed something wrong: one sentence, with what to do."""

from pathlib import Path

import pytest
from cli_runs import refused


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("simulate reference --noise 0.3mm,-0.3deg", "both must be more than 0"),
        ("simulate reference --noise-correlation 0.3", "say how large with --noise"),
        ("simulate reference --noise-student 5", "say how large with --noise"),
        ("simulate reference --contact filed", "'filed' is not one of 'field', 'mesh'. See: "),
        ("simulate reference --workers -2", "Invalid value for '--workers'"),
        ("simulate reference --workers ten", "neither a number of processes nor the address"),
        ("simulate reference --seed 99999999999999999999", "--seed is too large; give at most"),
        ("sweep reference x.csv --n-starts 1000000000", "--n-starts is too large; give at most"),
        ("simulate reference --protocol seed36", "Did you mean seed63?"),
        ("fit reference nothere.csv", "nothere.csv: there is no such file."),
        ("reveal nothere nowhere", "Give the folder of blind first and that of diagnose second."),
        ("subject check nothere", "Named subjects are reference, lenhart2015, lenhart2015_stable,"),
    ],
)
def test_one_sentence_names_what_is_wrong_and_the_remedy(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    sentence = refused(*words.split())
    assert said in sentence
    assert "Value error" not in sentence


def test_a_file_that_is_no_text_leaves_the_terminal_alone(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_bytes(b"\x07\x1b[31m\x00,b\n1,2\n")
    sentence = refused("fit", "reference", tmp_path / "data.csv", "--out", tmp_path / "fit")
    assert sentence.isprintable()
