"""What is told to someone who typed something wrong: one sentence, with what to do."""

from pathlib import Path

import pytest
from cli_runs import refused, run
from golden_texts import Golden

MISTAKES = (
    "simulate reference --noise 0.3mm,-0.3deg",
    "simulate reference --noise-correlation 0.3",
    "simulate reference --noise-student 5",
    "simulate reference --contact filed",
    "simulate reference --workers -2",
    "simulate reference --workers ten",
    "simulate reference --seed 99999999999999999999",
    "sweep reference x.csv --n-starts 1000000000",
    "simulate reference --protocol seed36",
    "fit reference nothere.csv",
    "reveal nothere nowhere",
    "subject check nothere",
)


def test_one_sentence_names_what_is_wrong_and_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.chdir(tmp_path)
    said = [f"$ identknee {words}\n{refused(*words.split())}" for words in MISTAKES]
    golden("said/refusals", "\n\n".join(said))


def test_a_file_that_is_no_text_leaves_the_terminal_alone(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_bytes(b"\x07\x1b[31m\x00,b\n1,2\n")
    sentence = refused("fit", "reference", tmp_path / "data.csv", "--out", tmp_path / "fit")
    assert sentence.isprintable()


def test_the_verbs_that_have_an_unknown_option_are_named() -> None:
    found = run("fit", "reference", "data.csv", "--n-starts", "3")
    assert found.exit_code == 2
    assert " sweep" in found.stderr
    assert " sweep" not in run("fit", "reference", "data.csv", "--n-startings", "3").stderr
    assert " profile" in run("sweep", "reference", "data.csv", "--quantity", "x").stderr
    assert " profile" not in run("fit", "--subject", "reference").stderr
