"""The knee in three dimensions in a real browser, from a file on disk."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from browsers import browser_in, prefer, resize

from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.report.page.viewer import KneeScene, model_scene, viewer_html
from identknee.runs.declare import Array
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee

plotly = pytest.importorskip("plotly.offline", reason="plotly is not installed")

PLACES = 1e-3  # mm
SECONDS = 30.0  # for the page to draw itself in software
# As strict as a page can be that holds its own code.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)
STYLE = (
    ":root { --ink: #102030; --paper: #fefefe; --muted: #607080 }"
    "@media (prefers-color-scheme: dark) {"
    ":root { --ink: #e0e0f0; --paper: #101418; --muted: #90a0b0 } }"
    "body { background: var(--paper); margin: 1rem }"
)
ARROW_RIGHT, HOME = "\ue014", "\ue011"
PLOTTED = "yzx"  # the plot's axes that are anterior, superior and lateral
# Traces of the drawing.
TIBIA, FIRST_LINE = 1, 4


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page with a scene that holds and one whose knee has nothing to hold it."""

    browser: Any
    scene: KneeScene

    def ask(self, question: str) -> Any:
        return self.browser.execute_script(
            f"const knee = document.querySelectorAll('.knee-viewer')[0];"
            f"const plot = knee.querySelector('.kv-plot'); return {question}"
        )

    def find(self, what: str) -> Any:
        return self.browser.find_element("css selector", what)

    def text(self, what: str) -> str:
        return str(self.ask(f"knee.querySelector('{what}').textContent"))

    def places(self, trace: int) -> Array:
        """Anterior, superior and lateral place of what a trace draws [mm]."""
        return np.array([self.ask(f"plot.data[{trace}].{axis}") for axis in PLOTTED]).T

    def tibia(self) -> Array:
        return self.places(TIBIA)

    def move_to(self, trial: int) -> None:
        self.browser.execute_script(
            "const slider = document.querySelector('.knee-viewer input');"
            f"slider.value = {trial}; slider.dispatchEvent(new Event('input'));"
        )

    def expected(self, trial: int) -> Array:
        return self.scene.trials[trial].placement.to_femur(self.scene.tibia.vertices)

    def wait(self, condition: Callable[[], bool]) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(self.browser, SECONDS, 0.05).until(lambda _: condition())


@pytest.fixture(scope="module")
def page(reference: Knee, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    folder = tmp_path_factory.mktemp("page")
    protocol = load_protocol("seed63")
    model = LaxityModel(knee=reference, protocol=protocol.select([0, 15, 31, 40, 62]))
    theta = np.array(model.parameters.center)
    scene = model_scene(model, theta, missing_line=np.array([[5.0, 0.0, 38.0], [9.0, -40.0, 30.0]]))
    theta[: len(reference.ligaments)] = 0.0
    loose = model_scene(model, theta)
    path = folder / "page.html"
    path.write_text(
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Knee</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}"><style>{STYLE}</style>'
        f"<script>{plotly.get_plotlyjs()}</script></head><body>{viewer_html(scene)}"
        f"{viewer_html(loose)}</body></html>",
        encoding="utf-8",
    )
    browser = browser_in(folder)
    try:
        found = Page(browser=browser, scene=scene)
        resize(found.browser, 1100, 800)
        prefer(found.browser, "light")
        browser.get(path.as_uri())
        ready = "[...document.querySelectorAll('.knee-viewer')].every((x) => x.dataset.ready)"
        found.wait(lambda: bool(found.ask(ready)))
        yield found
    finally:
        browser.quit()


def test_slider_moves_the_tibia_as_the_model_does(page: Page) -> None:
    seen = []
    for trial in (0, 2, 4, 1):
        page.move_to(trial)
        seen.append(page.tibia())
        assert np.abs(seen[-1] - page.expected(trial)).max() < PLACES
        assert page.text(".kv-loads") == page.scene.trials[trial].loads
        assert page.scene.trials[trial].name in page.text(".kv-name")
    assert np.abs(seen[1] - seen[0]).max() > 5.0  # mm: it did move


def test_lines_end_on_the_bones_and_say_their_forces(page: Page) -> None:
    page.move_to(4)
    trial = page.scene.trials[4]
    tibial = trial.placement.to_femur(page.scene.lines.tibial)
    for k, name in enumerate(page.scene.names):
        ends = page.places(FIRST_LINE + k)
        assert np.abs(ends[0] - page.scene.lines.femoral[k]).max() < PLACES
        assert np.abs(ends[-1] - tibial[k]).max() < PLACES
        force = trial.tensions[k]
        said = re.search(rf"\b{name} (slack|(\d+) N)", page.text(".kv-said"))
        assert said is not None
        assert float(said.group(2) or 0.0) == pytest.approx(force, abs=0.51)  # N, rounded
        width = page.ask(f"plot.data[{FIRST_LINE + k}].line.width")
        assert (width < 5) == (force == 0.0)
    assert page.ask("plot.data.at(-1).name") == "missing line"


def test_patch_of_contact_is_as_deep_as_the_model_says(page: Page) -> None:
    page.move_to(3)
    trial = page.scene.trials[3]
    depths = np.array(page.ask(f"plot.data[{TIBIA}].intensity"))
    assert np.abs(depths[trial.near] - trial.depths).max() < PLACES
    assert (depths > 0.0).sum() == (trial.depths > 0.0).sum()


def test_keyboard_moves_the_slider_and_the_knee(page: Page) -> None:
    page.move_to(1)
    slider = page.find(".knee-viewer input")
    slider.send_keys(ARROW_RIGHT)
    assert np.abs(page.tibia() - page.expected(2)).max() < PLACES
    assert slider.get_attribute("aria-valuetext") == page.scene.trials[2].loads
    slider.send_keys(HOME)
    assert np.abs(page.tibia() - page.expected(0)).max() < PLACES


def test_buttons_step_and_play(page: Page) -> None:
    page.move_to(0)
    page.find("[data-step='-1']").click()
    assert np.abs(page.tibia() - page.expected(4)).max() < PLACES  # round and round
    page.find("[data-step='1']").click()
    play = page.find(".kv-play")
    play.click()
    assert play.get_attribute("aria-pressed") == "true"
    page.wait(lambda: page.ask("knee.querySelector('input').value") == "1")
    play.click()
    assert play.get_attribute("aria-pressed") == "false"
    assert play.text == "Play"


def test_view_is_kept_from_trial_to_trial(page: Page) -> None:
    page.find("[data-view='back']").click()
    page.move_to(3)
    assert page.ask("plot._fullLayout.scene.camera.eye.y") < -1.0
    assert page.ask("knee.querySelectorAll('.kv-compass text').length") == 3
    page.find("[data-view='oblique']").click()


def test_colours_follow_the_page(page: Page) -> None:
    light = page.ask("plot.layout.paper_bgcolor")
    prefer(page.browser, "dark")
    page.wait(lambda: page.ask("plot.layout.paper_bgcolor") != light)
    assert (light, page.ask("plot.layout.paper_bgcolor")) == ("#fefefe", "#101418")
    prefer(page.browser, "light")
    page.wait(lambda: page.ask("plot.layout.paper_bgcolor") == light)


def test_it_fits_a_phone(page: Page) -> None:
    resize(page.browser, 380, 800)
    try:
        page.wait(lambda: page.ask("plot._fullLayout.width") <= 380)
        assert page.ask("document.documentElement.scrollWidth") <= 380
    finally:
        resize(page.browser, 1100, 800)


def test_knee_without_equilibrium_says_why(page: Page) -> None:
    second = "document.querySelectorAll('.knee-viewer')[1]"
    assert Outcome.UNCONSTRAINED.sentence in page.ask(
        f"{second}.querySelector('.kv-outcome').textContent"
    )
    assert page.ask(f"{second}.querySelector('.kv-outcome').hidden") is False
    assert page.ask(f"{second}.querySelector('td:last-child').textContent") == "no value"


def test_print_has_words_in_place_of_the_picture(page: Page) -> None:
    page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        shown = "getComputedStyle(knee.querySelector('{}')).display"
        assert page.ask(shown.format(".kv-stage")) == "none"
        assert page.ask(shown.format(".kv-words")) == "block"
        assert "largest force" in page.text(".kv-words")
    finally:
        page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_nothing_goes_wrong_and_nothing_is_fetched(page: Page) -> None:
    assert page.ask("performance.getEntriesByType('resource').map((x) => x.name)") == []
    logged = page.browser.get_log("browser")
    assert [x["message"] for x in logged if x["level"] == "SEVERE"] == []
