import contextlib
import io
import re
import sys
import time
from types import SimpleNamespace

import pytest

from identknee.runs import progress as module
from identknee.runs import progress as progress_lines
from identknee.runs.progress import (
    counted,
    finished,
    planned,
    progress,
    progress_bar,
    stage,
    time_left,
    whole_stage,
)


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


def test_long_work_away_from_a_terminal_says_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(progress_lines, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with progress_bar("simulating", 100) as advance:
        for now[0] in (29.0, 31.0, 40.0, 70.0):
            advance(10)
    said = re.findall(r": (\d+) of 100, \w+ (\d+ \w+)", capsys.readouterr().err)
    assert said == [("20", "2 min"), ("40", "100 s")]


def test_how_to_shorten_long_work_is_said_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    work = {"first": [1.0] * 100}
    with planned("all", work, shorter="Less."), progress_bar("first", 100) as advance:
        for now[0] in (10.0, 20.0, 30.0):
            advance(2)
    said = capsys.readouterr().err
    assert said.count("Less.") == 1
    assert "8 min left" in said.partition("Less.")[0]


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
        advance.say("said-before")
        while "said" not in terminal.getvalue() and time.monotonic() < deadline:
            time.sleep(0.01)
        advance(3)
    assert "simulating" in terminal.getvalue()
    assert terminal.getvalue().count("identknee: said-before") == 1
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
        assert type(after) is type(outer)


def test_time_left_counts_no_work_of_an_earlier_run() -> None:
    assert time_left(10.0, 0.2) == pytest.approx(40.0)
    assert time_left(10.0, 0.6, before=0.5) == pytest.approx(40.0)
    assert time_left(10.0, 0.505, before=0.5) is None
    assert time_left(10.0, 1.2) == 0.0


class Recorded:
    """A bar that keeps what it is told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, str, float | None]] = []

    def __call__(self, count: int, /) -> None:
        raise AssertionError

    def to(self, share: float, note: str = "", left_s: float | None = None) -> None:
        self.told.append((share, note, left_s))

    def say(self, sentence: str, /) -> None:
        raise AssertionError(sentence)


def test_a_plan_knows_the_maps_to_come(monkeypatch: pytest.MonkeyPatch) -> None:
    bar, now = Recorded(), [0.0]
    monkeypatch.setattr(module, "_bar", lambda *_, **__: contextlib.nullcontext(bar))
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with planned("all", {"first": [1.0] * 4, "second": [3.0, 3.0]}):
        with progress_bar("first", 4, before=2) as advance:
            now[0] = 10.0
            advance(1)
        with progress_bar("unknown", 9) as advance:
            advance(9)
        with progress_bar("first", 1) as advance:
            now[0] = 20.0
            advance(1)
        with progress_bar("second", 2) as advance:
            now[0] = 50.0
            advance(1)
    # Of 10 units 2 were there before; each takes 10 s.
    done = [x[2] for x in bar.told if x[2] is not None]
    assert [x[:2] for x in bar.told][:2] == [(0.2, "first"), (0.3, "first")]
    assert bar.told[-1][:2] == (0.7, "second")
    assert done == pytest.approx([70.0, 70.0, 60.0, 60.0, 30.0])


def test_a_part_may_know_its_costs_better_than_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    bar, now = Recorded(), [0.0]
    monkeypatch.setattr(module, "_bar", lambda *_, **__: contextlib.nullcontext(bar))
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with planned("all", {"first": [1.0], "second": [100.0]}):
        with stage("first"):
            now[0] = 10.0
        with progress_bar("second", 2, costs=[1.0, 2.0]) as advance:
            assert list(counted("ab", advance)) == ["a", "b"]
    assert bar.told[2] == pytest.approx((0.25, "second", 30.0))
    assert bar.told[-1][0] == 1.0


def test_a_plan_is_told_what_will_not_be_done_and_never_goes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bar, now = Recorded(), [0.0]
    monkeypatch.setattr(module, "_bar", lambda *_, **__: contextlib.nullcontext(bar))
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    work = {"first": [1.0], "perhaps": [3.0] * 2, "last": [2.0, 1.0]}
    with planned("all", work):
        with stage("first"):
            now[0] = 10.0
        finished("perhaps", "unknown")
        assert bar.told[-1] == pytest.approx((0.7, "perhaps", 10.0 * 3.0 / 7.0))
        with whole_stage("last"), stage("first"):
            finished("last")
        assert bar.told[-1][:2] == pytest.approx((0.9, "last"))
        # One item more than was planned.
        with stage("first"):
            pass
        with progress_bar("last", 9):
            pass
    shares = [x[0] for x in bar.told]
    assert shares == sorted(shares)
    # What is counted within a whole stage is not shown.
    assert len(shares) == 8


def test_time_left_goes_down_within_an_item(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    left = module._TimeLeftColumn(50.0)
    now[0] = 20.0
    assert str(left) == "about 30 s left"
