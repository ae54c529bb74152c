"""The page: its order, its structure, and that it needs and fetches nothing."""

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from diagnoses import FRAME, answered
from golden_texts import Golden
from markupsafe import Markup
from posed_knees import posed_reference
from report_folders import (
    OPEN_BELOW,
    diagnosis_folder,
    few_trials,
    fit_folder,
    profile_folder,
    write_given,
    write_verb,
)

from identknee.report.overview import overview
from identknee.report.page.markup import parts
from identknee.report.page.page import MOST_ROWS, lead_of, report_drawings, report_html
from identknee.report.page.viewer import scene_of
from identknee.report.presenter import Column, Table
from identknee.report.results import by_subject, found_results
from identknee.runs.errors import InputError
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import untestable
from identknee.verbs.fit import Calibration

EVIL = '<script>alert(1)</script> & "knee"'
EMPTY = {"meta", "link", "br", "img", "input", "hr", "path", "use"}


@dataclass
class Seen(HTMLParser):
    """What a page is made of."""

    tags: Counter[str] = field(default_factory=Counter)
    ids: Counter[str] = field(default_factory=Counter)
    references: list[str] = field(default_factory=list)
    headings: list[tuple[int, str]] = field(default_factory=list)
    drawings: list[dict[str, str | None]] = field(default_factory=list)
    pictures: list[dict[str, str | None]] = field(default_factory=list)
    stack: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(  # type: ignore[explicit-override]
        self, tag: str, attrs: list[tuple[str, str | None]]
    ) -> None:
        found = dict(attrs)
        self.tags[tag] += 1
        if found.get("id"):
            self.ids[str(found["id"])] += 1
        self.references += [str(found[x]) for x in ("href", "src") if x in found]
        if re.fullmatch(r"h[1-6]", tag):
            self.headings.append((int(tag[1]), ""))
        if tag == "svg" and found.get("class") == "drawing":
            self.drawings.append(found)
        if tag == "img":
            self.pictures.append(found)
        if tag not in EMPTY:
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:  # type: ignore[explicit-override]
        if tag not in EMPTY:
            assert self.stack.pop() == tag

    def handle_startendtag(  # type: ignore[explicit-override]
        self, tag: str, attrs: list[tuple[str, str | None]]
    ) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in EMPTY:
            self.stack.pop()

    def handle_data(self, data: str) -> None:  # type: ignore[explicit-override]
        if self.headings and self.stack and re.fullmatch(r"h[1-6]", self.stack[-1]):
            level, text = self.headings[-1]
            self.headings[-1] = level, text + data


def seen(page: str) -> Seen:
    parser = Seen()
    parser.feed(page)
    parser.close()
    assert parser.stack == []
    return parser


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three verbs on a knee whose ligaments have other names, in three folders."""
    whole = tmp_path_factory.mktemp("results")
    knee = posed_reference(seed=3, side="right")
    fit_folder(whole / "fit", knee, subject=EVIL)
    profile_folder(whole / "profile", subject=EVIL)
    diagnosis_folder(whole / "more" / "diagnose", subject=EVIL)
    return whole


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return report_html(found_results(folder))


def test_the_answer_comes_first_and_headings_are_in_order(page: str, golden: Golden) -> None:
    headings = seen(page).headings
    assert [level for level, _ in headings].count(1) == 1
    golden("said/headings", "\n".join(text for level, text in headings if level == 2))
    levels = [level for level, _ in headings]
    assert levels[0] == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))


def test_every_figure_says_what_it_shows(page: str) -> None:
    found = seen(page)
    assert len(found.drawings) == 9
    for drawing in found.drawings:
        assert drawing["role"] == "img"
        title = re.search(rf'<title id="{drawing["aria-labelledby"]}">(.+?)</title>', page)
        assert title is not None
        assert len(title[1]) > 20
    assert all(x["alt"] for x in found.pictures)


def test_identities_are_unique_and_references_stay_inside(page: str) -> None:
    found = seen(page)
    assert [x for x, n in found.ids.items() if n > 1] == []
    inner = {x[1:] for x in found.references if x.startswith("#")}
    inner |= set(re.findall(r"url\(#([^)]+)\)", page))
    assert inner <= set(found.ids)
    assert [x for x in found.references if not x.startswith(("#", "data:"))] == []


def test_words_from_outside_are_escaped(page: str) -> None:
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert seen(page).tags["script"] == 1


def test_a_page_without_a_knee_holds_no_library(page: str) -> None:
    assert "Plotly" not in page
    assert '<html lang="en">' in page
    assert 'name="viewport"' in page
    assert "connect-src" not in page
    assert "default-src 'none'" in page


def test_an_open_end_is_said_to_be_open(page: str) -> None:
    words = re.sub(r"<[^>]+>", " ", page).replace("&nbsp;", " ")
    assert "95 % confidence" in words
    assert "1 of the 2" in words
    assert re.search(r"\(at most \S+ %\)", words)
    assert OPEN_BELOW.partition(".")[0] in words


def test_what_was_not_done_is_offered_with_its_command(page: str) -> None:
    assert "identknee design" in page
    assert "identknee profile &#39;" not in page
    # A shell sees the name of the subject as one word.
    assert "identknee sweep &#39;&lt;script&gt;alert(1)&lt;/script&gt; &amp; " in page


def test_the_answer_is_a_verdict_and_a_table(page: str) -> None:
    answer = page[page.index('id="answer-1"') : page.index("<nav")]
    assert answer.count('class="verdict wrong"') == 1
    assert answer.count('class="overview"') == 1
    # Nothing of it is folded but the ranges of each method.
    assert answer.count("<summary>") == 1
    assert answer.index('class="overview"') < answer.index("<summary>")
    answer = answer[: answer.index("<details")]
    assert answer.count('<th scope="row">') == len(set(re.findall(r'row">([^<]+)', answer))) > 2


def test_table_laxity_and_next_step_come_before_all_else(page: str) -> None:
    answer = page[page.index('id="answer-1"') : page.index("<nav")]
    places = [answer.index(x) for x in ('"verdict', '"overview"', "<figure", '"next"', ">Fits<")]
    assert places == sorted(places)
    (figure,) = re.findall("<figure.+?</figure>", answer, re.DOTALL)
    assert "Displacement along each load" in figure
    assert "dots: measured" in figure
    # It stands there alone.
    assert page.count(figure) == 1


def test_rows_beyond_a_screen_are_folded_in_their_order() -> None:
    (row, *_) = overview([answered(FRAME)]).rows
    rows = tuple(replace(row, label=f"row {k}") for k in range(MOST_ROWS + 3))
    found = replace(overview([answered(FRAME)]), rows=rows)
    lead = lead_of(found, [], Markup(""), [], [])
    assert [x.label for x in (*lead.rows, *lead.folded)] == [x.label for x in rows]
    assert len(lead.folded) == 3
    html = str(parts().lead(lead, "findings-1", 2))
    assert html.index("3 more rows") < html.index(f"row {MOST_ROWS}<")


def test_a_step_is_shown_where_none_is_advised() -> None:
    found = overview([untestable("Silence.")])
    fit, profile = (("Why?", f"identknee {x} knee table.csv") for x in ("fit", "profile"))
    assert lead_of(found, [], Markup(""), [], [fit, profile]).step == fit
    # What was fitted is asked how well it is known.
    fitted = replace(found, searches=("The fit ended.",))
    assert lead_of(fitted, [], Markup(""), [], [fit, profile]).step == profile
    assert lead_of(fitted, [], Markup(""), [], [fit]).step == fit
    advised = replace(found, next_tests=("Pull harder.",))
    assert lead_of(advised, [], Markup(""), [], [fit]).step is None


def test_a_fit_alone_says_its_parameters_at_once() -> None:
    given = Table(title="Fitted parameters", columns=(Column("parameter"),), rows=(("ACL",),))
    fitted = replace(overview([untestable("Silence.")]), rows=(), searches=("The fit ended.",))
    lead = lead_of(fitted, [], Markup(""), [given], [])
    assert str(parts().lead(lead, "findings-1", 2)).count(f"{given.title}</caption>") == 1
    others = replace(overview([answered(FRAME)]), searches=("The fit ended.",))
    assert others.rows
    assert lead_of(others, [], Markup(""), [given], []).fitted == ()


def test_a_page_of_a_simulation_begins_with_what_it_says() -> None:
    page = report_html(found_results(Path(__file__).parents[2] / "fuzz" / "results" / "simulate"))
    answer = page[page.index('id="answer-1"') : page.index("<nav")]
    (sentence,) = re.findall('"verdict open">(.+?)</p>', answer)
    first, *_ = sentence.split(". ")
    assert re.findall(r"\d+", first) == ["7"]
    assert "stable" in first
    assert page.count(first) == 1


@pytest.mark.slow
def test_fits_of_one_table_stand_side_by_side(reference: Knee, tmp_path: Path) -> None:
    for name in "ab":
        fit_folder(tmp_path / name, reference)
    page = report_html(found_results(tmp_path))
    assert page.count("<caption>Fitted parameters") == page.count("by start</caption>") == 1
    # What both take for granted is said once, and whose it is where there is another result.
    assert page.count("result rests") == 1
    profile_folder(tmp_path / "c")
    page = report_html(found_results(tmp_path))
    assert page.count("result rests") == 1


def test_numbers_stand_behind_what_is_said(page: str) -> None:
    said = page[page.index("<nav") :]
    assert said.count("<summary>") >= 5


def test_two_subjects_are_kept_apart(tmp_path: Path) -> None:
    profile_folder(tmp_path / "a", subject="first", digest="1" * 64)
    profile_folder(tmp_path / "b", subject="second", digest="2" * 64)
    results = found_results(tmp_path)
    assert [x.subject for x in by_subject(results)] == ["first", "second"]
    found = seen(report_html(results))
    # What both say comes first, side by side.
    headings = ["Side by side", "Subject first", "Subject second"]
    assert [x for x in found.headings if x[0] == 2] == [(2, x) for x in headings]
    assert [x for x, n in found.ids.items() if n > 1] == []


def test_the_same_results_make_the_same_page(tmp_path: Path) -> None:
    results = found_results(profile_folder(tmp_path))
    assert report_html(results) == report_html(results)


def test_every_figure_has_a_file_name_of_its_own(folder: Path) -> None:
    names = [name for name, _ in report_drawings(found_results(folder))]
    assert len(set(names)) == len(names) == 9
    assert "profile-intervals" in names


def test_the_knee_stands_as_it_was_fitted(reference: Knee, tmp_path: Path) -> None:
    fit_folder(tmp_path, reference)
    (findings,) = by_subject(found_results(tmp_path))
    scene = scene_of(findings, reference)
    assert scene is not None
    assert len(scene.trials) == few_trials().n
    answer = findings.results[0].answer
    assert isinstance(answer, Calibration)
    drawn = np.array([x.coordinates for x in scene.trials])
    # The same parameters by another path to the same equilibria.
    np.testing.assert_allclose(drawn, answer.coordinates, atol=1e-6)


def test_results_without_trials_have_no_knee(reference: Knee, tmp_path: Path) -> None:
    profile_folder(tmp_path)
    (findings,) = by_subject(found_results(tmp_path))
    assert scene_of(findings, reference) is None


def _broken(folder: Path, name: str, content: str) -> Path:
    profile_folder(folder)
    (folder / name).write_text(content, encoding="utf-8")
    return folder


def test_folders_that_hold_nothing_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    empty = tmp_path / "empty"
    empty.mkdir()
    broken = _broken(tmp_path / "json", "result.json", "{")
    torn = _broken(tmp_path / "nc", "result.nc", "none")
    for path, why in (
        (tmp_path / "missing", "there is no such folder"),
        (file, "this is a file, not a folder"),
        (empty, "there are no results in it"),
        (broken, "this is not JSON"),
        (torn, "it is not the file that was written with result.json"),
    ):
        with pytest.raises(InputError, match=why):
            found_results(path)


def test_what_is_no_result_is_passed_over(tmp_path: Path) -> None:
    profile_folder(tmp_path / "profile")
    write_verb(tmp_path / "blind", "blind", {"secret": True})
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "result.json").write_text("[1, 2]", encoding="utf-8")
    assert [x.verb for x in found_results(tmp_path)] == ["profile"]


def test_a_result_that_could_not_be_had_is_still_reported(tmp_path: Path) -> None:
    write_given(tmp_path, "diagnose", untestable("Silence."))
    page = report_html(found_results(tmp_path))
    assert 'class="verdict open"' in page
    assert "Silence." in page
