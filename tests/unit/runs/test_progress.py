import io
import sys
import time

import pytest

from identknee.runs import progress as module
from identknee.runs.progress import progress, progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:  # type: ignore[explicit-override]
        return True


def test_items_pass_through_in_order() -> None:
    assert list(progress([3, 1, 2], description="counting")) == [3, 1, 2]
    assert list(progress(iter("ab"), description="counting")) == ["a", "b"]


def test_nothing_is_shown_away_from_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "DELAY_S", 0.0)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar("simulating", 2) as advance:
        time.sleep(0.05)
        advance(2)
    assert capsys.readouterr() == ("", "")


def test_nothing_is_shown_for_short_work(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert list(progress(range(5), description="simulating")) == list(range(5))
    assert terminal.getvalue() == ""


@pytest.mark.parametrize("total", [4, None])
def test_a_bar_is_shown_for_long_work_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, total: int | None
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(module, "DELAY_S", 0.01)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress_bar("simulating", total) as advance:
        advance(1)
        deadline = time.monotonic() + 20
        while "simulating" not in terminal.getvalue() and time.monotonic() < deadline:
            time.sleep(0.01)
        advance(3)
    assert "simulating" in terminal.getvalue()
    assert "4/" in terminal.getvalue()


def test_an_error_passes_through(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    with pytest.raises(RuntimeError, match="stop"), progress_bar("simulating", 1):
        raise RuntimeError("stop")


def test_a_bar_inside_a_bar_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress_bar("outer", 2) as outer, progress_bar("inner", 2) as inner:
        assert inner is not outer
        inner(1)
        outer(1)
    with progress_bar("after", 1) as after:
        assert after.__qualname__ == outer.__qualname__
