"""How one input ended, and whether that was well."""

import io
import json
import logging
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from typer.testing import CliRunner

import identknee as ik
from identknee.cli.app import app, is_identknee_error
from identknee.runs import crash_report as unforeseen

SLOWEST_S = 60.0
LONGEST_SENTENCE = 8000
# What the safety net says; here it counts as a failure.
UNFORESEEN = "this should not have happened"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """How one input ended.

    Attributes
    ----------
    kind
        ``"done"``, ``"refused"`` or ``"failed"``.
    what
        The sentence of a refusal, or why it is a failure.
    seconds
        How long it took.
    """

    kind: str
    what: str
    seconds: float


def judged(action: Callable[[], str]) -> Ending:
    """How an action ends: with an empty text, with a sentence, or in a way that it must not."""
    said = io.StringIO()
    began = time.perf_counter()
    with warnings.catch_warnings(), redirect_stderr(said):
        # A raw warning would reach a terminal.
        warnings.simplefilter("error")
        # What has no handler of its own would be printed.
        logging.lastResort = logging.StreamHandler(said)
        try:
            sentence = action()
        except Exception as error:  # noqa: BLE001
            sentence, fault = str(error), _fault_of(error)
        else:
            fault = ""
    seconds = time.perf_counter() - began
    if not fault and said.getvalue():
        fault = f"printed {said.getvalue()[:500]!r}"
    if not fault and seconds > SLOWEST_S:
        fault = f"took {seconds:.0f} s"
    if not fault and sentence and _is_no_sentence(sentence):
        fault = f"no sentence: {sentence[:500]!r}"
    kind = "failed" if fault else "refused" if sentence else "done"
    return Ending(kind=kind, what=fault or sentence, seconds=seconds)


def commanded(words: list[str], out: Path | None = None) -> str:
    """The sentence a command ends with, empty after success; a bad ending is an AssertionError."""
    read = ik.read_subject
    knees: dict[str, ik.Knee] = {}

    def read_once(name: str) -> ik.Knee:
        if name not in knees:
            knees[name] = read(name)
        return knees[name]

    with (
        patch.object(ik, "read_subject", read_once),
        patch("identknee.verbs.verb.read_subject", read_once),
        patch.object(unforeseen, "report_unexpected_error", _raise),
        patch("identknee.cli.app.report_unexpected_error", _raise),
    ):
        result = CliRunner().invoke(app, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    _check_folder(out, result.exit_code)
    if result.exit_code == 0:
        return ""
    # A check that found errors has said so, and what it found is written.
    if words[:2] == ["subject", "check"] and out is not None and (out / "result.json").exists():
        return "findings"
    lines = result.stderr.rstrip("\n").split("\n")
    # Usage of a verb that lacks an argument comes with its own lines.
    is_usage = lines[0].startswith("Usage: ")
    if result.exit_code not in (1, 2) or not (is_usage or lines[-1].startswith("identknee: ")):
        raise AssertionError(f"exit code {result.exit_code}: {result.output[:500]!r}")
    return lines[-1].removeprefix("identknee: ")[:LONGEST_SENTENCE]


def _raise(error: BaseException, *_: object) -> str:
    raise error


def _check_folder(out: Path | None, code: int) -> None:
    """Refuse a folder that is half-written."""
    if out is None or not out.is_dir():
        return
    parts = [x.name for x in out.rglob("*.part")]
    if parts:
        raise AssertionError(f"left {parts}")
    has_result = (out / "result.json").exists()
    if has_result:
        json.loads((out / "result.json").read_text(encoding="utf-8"))
    elif code == 2 and [x for x in out.iterdir() if x.name != "work.sqlite"]:
        raise AssertionError(f"half-written: {sorted(x.name for x in out.iterdir())}")


def _fault_of(error: Exception) -> str:
    """Why an error is no refusal; empty where it is one."""
    if isinstance(error, ValueError) and is_identknee_error(error):
        return ""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = "" if trace is None else f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
    return f"{type(error).__name__}: {str(error)[:300]} at {place}{_ours(error)}"


def _ours(error: Exception) -> str:
    """The last place of identknee on the way to an error."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        if "/identknee/" in trace.tb_frame.f_code.co_filename:
            name = trace.tb_frame.f_code.co_filename.rpartition("/identknee/")[2]
            place = f", from {name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _is_no_sentence(text: str) -> bool:
    return "\n" in text or len(text) > LONGEST_SENTENCE or UNFORESEEN in text or not text.strip()
