"""What a notebook shows of answers, and that a notebook with them runs."""

import asyncio
import inspect
import pydoc
from collections.abc import Callable
from functools import partial
from pathlib import Path

import nbformat
import pytest
from cli_runs import short_protocol
from diagnoses import FRAME, answered
from matplotlib.figure import Figure
from nbclient import NotebookClient
from report_folders import straight_profiles
from slow_cases import some_slow

import identknee as ik
from identknee.runs.record import record
from identknee.verbs.answer import Answer

# As verbs left them; those of a profile and a diagnosis are made here.
RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
STORED = ("simulate", "fit", "information", "sample", "morris", "sweep", "equivalents", "design")
ANSWERS: dict[str, Callable[[], Answer]] = {
    **{x: partial(ik.load, RESULTS / x) for x in STORED},
    "profile": straight_profiles,
    "diagnose": partial(answered, FRAME),
}
# Beside these verbs, and the texts and figures of all, which have tests of their own.
SLOW = ("diagnose", "sample", "morris", "sweep", "equivalents", "design")
CELLS = (
    "import identknee as ik",
    "knee = ik.reference_knee()",
    "data = ik.simulate(knee, 'drawer', noise='0.3mm,0.3deg', seed=1).noisy",
    "answer = ik.fit(knee, data, start='IG2', more_starts=0)",
    "answer",
    "answer.plot()",
    "ik.scene(knee)",
    "ik.scene_3d(knee, answer)",
    "ik.report(answer, 'page/report.html', knee=knee)",
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> ik.Laxity:
    protocol = ik.load_protocol(short_protocol(tmp_path_factory.mktemp("seen")))
    laxity = ik.simulate(ik.reference_knee(), protocol).laxity
    return ik.add_noise(laxity, sd_mm=0.3, sd_deg=0.3, seed=1)


@pytest.mark.parametrize("verb", some_slow(ANSWERS, SLOW))
def test_every_answer_is_short_to_see(verb: str) -> None:
    answer = ANSWERS[verb]()
    text, html = repr(answer), answer._repr_html_()
    assert text.startswith(f"{type(answer).__name__}:\n")
    assert len(text.splitlines()) <= 25
    assert max(map(len, text.splitlines())) <= 100
    assert len(html.encode()) <= 200_000
    assert '<img src="data:image/png' in html
    assert isinstance(answer.plot(), Figure)
    with pytest.raises(ValueError, match="figure 'none'"):
        answer.plot("none")


def test_data_and_models_are_short_too(data: ik.Laxity) -> None:
    knee = ik.reference_knee()
    model = ik.LaxityModel(knee=knee, protocol=ik.load_protocol("seed63"))
    prediction = model.predict(ik.load_start("subject", model.parameters))
    seen = (knee, knee.femur, model, model.protocol, model.parameters, prediction, data)
    for value in (*seen, ik.LaxityResiduals(model=model, laxity=data), straight_profiles().record):
        assert len(repr(value).splitlines()) <= 25
        assert len(repr(value)) <= 2_000


def test_help_fits_a_screen() -> None:
    text = pydoc.plain(pydoc.render_doc(ik))
    assert len(text.splitlines()) <= 45
    for name in ("read_subject", "fit", "profile", "diagnose", "report"):
        assert name in inspect.cleandoc(str(ik.__doc__))


@pytest.mark.slow
def test_the_report_takes_answers_folders_or_both(data: ik.Laxity, tmp_path: Path) -> None:
    knee = ik.reference_knee()
    ik.simulate(knee, data.protocol, out=tmp_path / "one")
    made = ik.fit(knee, data, budget=5, more_starts=0)
    page = ik.report([tmp_path / "one", made], tmp_path / "new" / "report.html")  # type: ignore[operator]
    text = page.read_text("utf-8")
    assert "simulate, fit" in text
    assert "knee-viewer" in text


def test_an_answer_of_no_call_is_shown_as_that_of_its_verb() -> None:
    from identknee.report.results import result_of

    assert result_of(straight_profiles()).verb == "profile"
    given = record("other", {}, {}).finish()
    assert given.verb == "other"


def test_a_knee_to_turn_needs_poses(data: ik.Laxity) -> None:
    with pytest.raises(ValueError, match=r"Profiles.*poses"):
        ik.scene_3d(ik.reference_knee(), straight_profiles())


def test_a_notebook_runs_and_shows_pictures(tmp_path: Path) -> None:
    cells = [{"cell_type": "code", "metadata": {}, "source": x, "outputs": []} for x in CELLS]
    written = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 4}
    notebook = nbformat.from_dict(written)  # type: ignore[no-untyped-call]
    client = NotebookClient(
        notebook, timeout=240, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    )
    asyncio.run(client.async_execute())
    shown = {x.source: [y.get("data", {}) for y in x.outputs] for x in notebook.cells}
    (answer,) = shown["answer"]
    assert "best fit" in answer["text/html"]
    assert answer["text/plain"].startswith("Calibration:")
    assert any("image/png" in x for x in shown["answer.plot()"])
    assert any("image/png" in x for x in shown["ik.scene(knee)"])
    (turned,) = shown["ik.scene_3d(knee, answer)"]
    assert turned["text/html"].startswith("<iframe")
    assert turned["text/plain"] == "Scene3D()"
    assert (tmp_path / "page" / "report.html").is_file()


AT_ONCE = """
import time
import identknee.runs.progress as module
module.DELAY_S, module.CELL_EVERY_S = 0.05, 0.0
"""
LONG = """
with module.progress_bar("fitting <a>", 4) as advance:
    advance(1)
    time.sleep(1.0)
    advance.say("Slow.")
    advance(3)
"""
LONG_CELLS = (AT_ONCE, LONG, "list(module.progress(range(3), description='short'))")


@pytest.mark.slow
def test_a_notebook_has_one_bar_that_changes_in_its_cell(tmp_path: Path) -> None:
    cells = [{"cell_type": "code", "metadata": {}, "source": x, "outputs": []} for x in LONG_CELLS]
    written = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 4}
    notebook = nbformat.from_dict(written)  # type: ignore[no-untyped-call]
    client = NotebookClient(
        notebook, timeout=240, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    )
    asyncio.run(client.async_execute())
    bars = [x for x in notebook.cells[1].outputs if x.output_type == "display_data"]
    (bar,) = (x.data for x in bars)
    assert '<progress value="4" max="4"' in bar["text/html"]
    assert "fitting &lt;a&gt;, 4/4" in bar["text/html"]
    assert bar["text/plain"].startswith("fitting <a>, 4/4, 1 s")
    said = "".join(x.text for x in notebook.cells[1].outputs if x.output_type == "stream")
    assert said == "identknee: Slow.\n"
    # What takes no time shows nothing.
    assert all(x.output_type == "execute_result" for x in notebook.cells[2].outputs)
