"""The whole page in a real browser, from disk: on a phone, by keyboard, in light and dark."""

from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import pytest
from browsers import browser_in, console_errors, prefer, requests_out, resize
from report_folders import fit_folder, profile_folder
from slow_cases import some_slow

from identknee.report.page.page import report_html
from identknee.report.page.viewer import scene_of
from identknee.report.results import by_subject, found_results
from identknee.subject.knee import Knee

pytest.importorskip("plotly.offline", reason="plotly is not installed")
pytest.importorskip("selenium", reason="selenium is not installed")
SECONDS = 30.0  # for the knee to be drawn in software
TAB, ENTER = "\ue004", "\ue007"
# WCAG 2.2, success criterion 1.4.3.
LEAST_CONTRAST = 4.5
WIDTHS = (380, 760, 1280)
# What a reader sees first on a wide screen, and how far down it may reach [px].
FIRST = (".verdict", "table.overview", ".glance figure", ".next + ul")
WIDE, FIRST_SCREENS = 1400, 1600
CONTRASTS = """
const number = (colour) => {
  const found = colour.match(/[\\d.]+/g).map(Number);
  return colour.startsWith("color(srgb") ? found.map((x, i) => (i < 3 ? 255 * x : x)) : found;
};
const light = (rgb) => {
  const part = rgb.slice(0, 3).map((x) => x / 255)
    .map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
  return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
};
const ground = (node) => {
  for (let at = node; at; at = at.parentElement) {
    const colour = number(getComputedStyle(at).backgroundColor);
    if (colour.length === 3 || colour[3] === 1) return colour;
  }
  return [255, 255, 255];
};
const ink = (node) => {
  const colour = number(getComputedStyle(node)[node.closest("svg") ? "fill" : "color"]);
  const share = colour.length === 3 ? 1 : colour[3];
  return ground(node).slice(0, 3).map((x, i) => share * colour[i] + (1 - share) * x);
};
// In a figure this black and this white lie on coloured maps, not on the page.
const onMap = (node) => node.closest("svg")
  && ["rgb(1, 1, 1)", "rgb(255, 255, 255)"].includes(getComputedStyle(node).fill);
const texts = "h1,h2,p,li,a,summary,th,td,caption,figcaption,code,button,svg.drawing text";
return [...document.querySelectorAll(texts)]
  .filter((x) => x.textContent.trim() && x.getClientRects().length && !x.classList.contains("skip"))
  .filter((x) => !onMap(x))
  .map((x) => {
    const pair = [light(ink(x)), light(ground(x))].sort((a, b) => b - a);
    return [(pair[0] + 0.05) / (pair[1] + 0.05), x.tagName + ": " + x.textContent.slice(0, 40)];
  });
"""

BROKEN_RULES = """
const tell = arguments[arguments.length - 1];
axe.run(document, { resultTypes: ["violations"] }).then((found) =>
  tell(found.violations.map((x) => [x.impact, x.id, x.nodes.map((y) => y.html.slice(0, 200))])));
"""


def until(browser: Any, question: str) -> None:
    """Wait until the page answers a question with yes."""
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, SECONDS).until(lambda x: x.execute_script(f"return {question}"))


@pytest.fixture(scope="module")
def browser(reference: Knee, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    folder = tmp_path_factory.mktemp("page")
    browser = browser_in(folder)
    try:
        fit_folder(folder / "fit", reference)
        profile_folder(folder / "profile")
        results = found_results(folder)
        (findings,) = by_subject(results)
        scene = scene_of(findings, reference)
        assert scene is not None
        page = folder / "report.html"
        html = report_html(results, {results[0].subject_digest: scene})
        page.write_text(html, encoding="utf-8")
        resize(browser, WIDTHS[-1], 800)
        browser.get(page.as_uri())
        yield browser
    finally:
        browser.quit()


def show_all(browser: Any) -> None:
    browser.execute_script("document.querySelectorAll('details').forEach(x => { x.open = true; })")


# First, while the log of the start is there.
def test_nothing_is_fetched_and_nothing_goes_wrong(browser: Any) -> None:
    show_all(browser)
    until(browser, "document.querySelectorAll('canvas').length > 0")
    assert console_errors(browser) == []
    assert requests_out(browser) == []


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_never_scrolls_sideways(browser: Any, width: int) -> None:
    show_all(browser)
    resize(browser, width, 800)
    # The drawing of the knee follows a little later.
    until(browser, f"innerWidth === {width} && document.documentElement.scrollWidth <= {width}")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_answer_table_laxity_and_next_step_are_on_the_first_screens(
    browser: Any, scheme: str
) -> None:
    resize(browser, WIDE, 800)
    prefer(browser, scheme)
    browser.refresh()
    ends = browser.execute_script(
        "return arguments[0].map(x => document.querySelector(x).getBoundingClientRect())"
        ".map(x => [x.top + scrollY, x.bottom + scrollY])",
        FIRST,
    )
    assert all(0.0 < top < bottom <= FIRST_SCREENS for top, bottom in ends)
    # The table and the picture are beside each other.
    assert ends[1][0] == pytest.approx(ends[2][0], abs=8.0)


def test_wide_figures_and_tables_scroll_by_themselves_and_by_keyboard(browser: Any) -> None:
    resize(browser, WIDTHS[0], 800)
    boxes = browser.execute_script(
        "return [...document.querySelectorAll('.scroll')]"
        ".filter(x => x.scrollWidth > x.clientWidth).map(x => [x.tabIndex, x.ariaLabel])"
    )
    assert boxes
    assert all(index == 0 and name for index, name in boxes)


@pytest.mark.parametrize(
    "seen",
    some_slow(["light", "dark unfolded", "light unfolded", "dark"], ["light unfolded", "dark"]),
)
def test_no_rule_of_accessibility_is_broken(browser: Any, seen: str) -> None:
    axe = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed")
    prefer(browser, seen.split()[0])
    if "unfolded" in seen:
        show_all(browser)
    browser.execute_script((files(axe) / "axe.min.js").read_text(encoding="utf-8"))
    assert browser.execute_async_script(BROKEN_RULES) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_text_stands_out(browser: Any, scheme: str) -> None:
    prefer(browser, scheme)
    show_all(browser)
    found = browser.execute_script(CONTRASTS)
    assert len(found) > 40
    assert sum(text.startswith("text: ") for _, text in found) > 40
    assert [x for x in found if x[0] < LEAST_CONTRAST] == []


def test_figures_follow_light_and_dark(browser: Any) -> None:
    inks = []
    for scheme in ("light", "dark"):
        prefer(browser, scheme)
        inks.append(
            browser.execute_script(
                "return getComputedStyle(document.querySelector('svg.drawing text')).fill"
            )
        )
    assert inks[0] != inks[1]


def test_the_keyboard_reaches_the_answer_and_opens_its_numbers(browser: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    browser.refresh()
    ActionChains(browser).send_keys(TAB).perform()
    assert str(browser.switch_to.active_element.get_attribute("href")).endswith("#main")
    assert browser.find_element("css selector", ".verdict").is_displayed()
    first = browser.find_element("css selector", "main li details")
    assert first.get_attribute("open") is None
    browser.execute_script("document.querySelector('main li summary').focus()")
    ActionChains(browser).send_keys(ENTER).perform()
    assert first.get_attribute("open") == "true"
    assert first.find_element("css selector", "table").is_displayed()


def test_a_link_to_something_folded_unfolds_it(browser: Any) -> None:
    browser.refresh()
    browser.execute_script(
        "const folded = document.querySelector('details'); folded.open = false;"
        "folded.querySelector('table').id = 'sought'; location.hash = '#sought'"
    )
    table = browser.find_element("css selector", "#sought")
    assert table.is_displayed()


def test_every_part_has_a_name_for_those_who_listen(browser: Any) -> None:
    lost = browser.execute_script(
        "return [...document.querySelectorAll('section,nav,[role=img],[role=region],input,button')]"
        ".filter(x => !(x.ariaLabel || x.title || x.textContent.trim() || x.labels?.length"
        " || x.getAttribute('aria-labelledby'))).map(x => x.outerHTML.slice(0, 80))"
    )
    assert lost == []
