"""A page says each thing once, however many results say it."""

from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from held import both_of
from report_folders import write_given
from typing_extensions import override

import identknee as ik
from identknee.report.page.page import report_html
from identknee.report.presenter import presenter_of, statements_of
from identknee.report.results import found_results
from identknee.verbs.answer import Answer

pytestmark = pytest.mark.usefixtures("no_drawings")

HELD = both_of("PCL", "LCL", "MCL")
# A longer one is a sentence, not a heading, a name or a number.
LONG = 60
BLOCKS = {"p", "li", "figcaption", "caption", "summary", "td", "th", "h2", "h3"}


class _Paragraphs(HTMLParser):
    """The texts of a page, block by block."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._own, self._unseen = "", 0

    def _end(self) -> None:
        if text := " ".join(self._own.split()):
            self.texts.append(text)
        self._own = ""

    @override
    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._unseen += tag in ("script", "style", "svg", "pre")
        if tag in BLOCKS:
            self._end()

    @override
    def handle_endtag(self, tag: str) -> None:
        self._unseen -= tag in ("script", "style", "svg", "pre")
        if tag in BLOCKS:
            self._end()

    @override
    def handle_data(self, data: str) -> None:
        if not self._unseen:
            self._own += data


def said_twice(page: str) -> list[str]:
    """Long paragraphs that a page has more than once."""
    parser = _Paragraphs()
    parser.feed(page)
    return [x for x, n in Counter(parser.texts).items() if n > 1 and len(x) > LONG]


@pytest.fixture(scope="module")
def answers() -> dict[str, Answer]:
    """What four verbs say of one table, whose noise is larger than stated."""
    knee = ik.reference_knee()
    laxity = ik.add_noise(ik.simulate(knee, "drawer").laxity, sd_mm=0.5, sd_deg=0.5, seed=1)
    how: Any = {"noise": "0.4mm,0.4deg", "fixed": HELD, "uncertain": "registration=1deg"}
    return {
        "fit": ik.fit(knee, laxity, more_starts=0, **how),
        "profile": ik.profile(knee, laxity, parameters=["ACL.stiffness_kN"], **how),
        "information": ik.information(knee, laxity, **how),
        "design": ik.design(
            knee,
            laxity,
            n_trials=1,
            targets=["ACL.stiffness_kN"],
            candidates="drawer",
            **how,
        ),
    }


def page_of(folder: Path, answers: dict[str, Answer]) -> str:
    for name, answer in answers.items():
        write_given(folder / name, name.rstrip("2"), answer)
    return report_html(found_results(folder))


def test_no_paragraph_stands_twice(answers: dict[str, Answer], tmp_path: Path) -> None:
    page = page_of(tmp_path, answers)
    assert said_twice(page) == []
    # Each is there, once: nothing was left out with its repeats.
    for answer in answers.values():
        first = statements_of(answer)[0].sentence
        assert page.replace("&nbsp;", " ").replace("&#39;", "'").count(first) == 1


@pytest.mark.slow
def test_results_that_say_the_same_of_the_same_table_share_it(
    answers: dict[str, Answer], tmp_path: Path
) -> None:
    """The same verbs once more, as with other settings that changed no number."""
    page = page_of(tmp_path, {**answers, **{f"{k}2": x for k, x in answers.items() if k != "fit"}})
    assert said_twice(page) == []


def test_a_single_answer_says_all_of_it(answers: dict[str, Answer]) -> None:
    for answer in answers.values():
        for statement in presenter_of(answer).statements(answer):
            assert statement.sentence in str(answer)
    bare = replace(answers["design"], assumptions=())
    assert statements_of(bare)[0].sentence in bare.brief()
