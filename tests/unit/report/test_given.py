"""What a notebook shows of a knee, a laxity table, trials and a model."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest
from figure_checks import faults

import identknee as ik
from identknee.laxity.table import example_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.report.notebook import shown
from identknee.runs.notebooks import show_in_notebooks

MEASURED = example_laxity("s192803")
KNEE = ik.example("s192803_bundles")
# By name: what is given, and words that are said of it.
GIVEN: dict[str, tuple[Any, tuple[str, ...]]] = {
    "knee": (KNEE, ("Left knee s192803_bundles: 14 ligaments", "MCLa", "stiffness [kN]")),
    "table": (MEASURED, ("25 trials at 5, 36, 57 and 87 deg", "125 values", "anterior force")),
    "trials": (ik.load_protocol("seed63"), ("63 trials at 0, 30 and 60 deg", "varus moment")),
    "model": (
        LaxityModel(knee=KNEE, protocol=MEASURED.protocol),
        ("with 8 parameters", "ACL stiffness [kN]"),
    ),
}


@pytest.mark.parametrize("name", GIVEN)
def test_what_is_given_is_said_and_drawn(name: str) -> None:
    given, words = GIVEN[name]
    seen = shown(given)
    assert [x for x in words if x not in seen.text] == []
    html = seen.html.replace("\N{NO-BREAK SPACE}", " ").replace("&nbsp;", " ")
    assert [x for x in words if x not in html] == []
    assert len(seen.text.splitlines()) <= 25
    assert '<img src="data:image/png;base64,iVBOR' in seen.html
    assert len(seen.html) <= 200_000
    figure = seen.draw()
    assert figure is not None
    assert faults(figure) == []


def test_notebooks_show_it_and_nothing_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    formatters = pytest.importorskip("IPython.core.formatters")
    shell = SimpleNamespace(display_formatter=formatters.DisplayFormatter())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    show_in_notebooks([("identknee.laxity.protocol", "Protocol")], shown)
    made, _ = shell.display_formatter.format(ik.load_protocol("drawer"))
    assert made["text/html"] == shown(ik.load_protocol("drawer")).html
    assert made["text/plain"] == shown(ik.load_protocol("drawer")).text
    other, _ = shell.display_formatter.format(MEASURED)
    assert "text/html" not in other
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    show_in_notebooks([("identknee.laxity.table", "Laxity")], shown)
    assert "text/html" not in shell.display_formatter.format(MEASURED)[0]
