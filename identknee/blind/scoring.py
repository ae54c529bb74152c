"""Comparison of a diagnosis with the truth."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from identknee.blind.effects import UNLISTED
from identknee.blind.truth import Truth
from identknee.runs.declare import Array, declared, entry

# Distance and angle to the true line within which a line found counts as the true one.
NEAR_MM, NEAR_DEG = 10.0, 15.0
# Name that a diagnosis gives to errors common to the trials of a flexion angle.
REMOUNTING = "remounting"
ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED = "ADEQUATE", "NAMED", "AMBIGUOUS", "UNEXPLAINED"


@declared
class Score:
    """A diagnosis compared with the truth."""

    verdict: str = entry("Verdict of the diagnosis")
    correct: bool = entry(
        "Whether it named all that is hidden and nothing else, gave a group that holds it, found "
        "nothing where nothing is hidden, or left unexplained what no library lists"
    )
    wrong: bool = entry("Whether it named a cause that is not there")
    in_group: bool | None = entry(
        "Whether all that is hidden is among the causes named and the group; null for a null"
    )
    sentence: str = entry("The comparison as a sentence")
    line_offset_mm: float | None = entry(
        "Distance of the line found from the middle of the true one; null without either", unit="mm"
    )
    line_angle_deg: float | None = entry("Angle between the two lines", unit="deg")
    amplitudes_covered: float | None = entry(
        "Share of the amplitudes of the true causes named whose intervals hold them; null without "
        "any",
        unit="1",
    )
    stiffness_error_kN: tuple[float | None, float | None] = entry(  # noqa: N815 - the unit
        "Mean absolute error of the stiffnesses before and after; null where not given", unit="kN"
    )
    strain_error_pct: tuple[float | None, float | None] = entry(
        "Mean absolute error of the reference strains before and after", unit="%"
    )
    covered_before: float | None = entry(
        "Share of the parameters' intervals that hold the truth before", unit="1"
    )
    covered_after: float | None = entry(
        "Share of the intervals that hold the truth after", unit="1"
    )


def score(truth: Truth, diagnosis: Mapping[str, Any]) -> Score:
    """Score of a diagnosis, the parsed ``result.json`` of `identknee diagnose`.

    The entries used are ``verdict``, ``causes[].{name,parameters,line}``, each parameter with its
    ``ci95``, ``group[]``, and ``line`` with its ends ``femur`` and ``tibia`` [mm]. Parameters by
    ligament and quantity are in ``parameters_before`` and ``parameters_after``, and their intervals
    under the same names ending in ``_ci95``.

    Raises
    ------
    ValueError
        If there is no verdict.
    """
    if "verdict" not in diagnosis:
        raise ValueError("the diagnosis has no verdict; give the result.json of identknee diagnose")
    verdict = str(diagnosis["verdict"])
    named = {str(x["name"]) for x in diagnosis.get("causes") or ()}
    group = {str(x) for x in diagnosis.get("group") or ()}
    hidden = set(truth.effects)
    # Errors of remounting are no hidden effect: a diagnosis may name them or not.
    mounted = {REMOUNTING} if truth.facts.get("largest_remounting", 0.0) else set()
    is_named = verdict == NAMED
    given = [diagnosis.get("line"), *(x.get("line") for x in diagnosis.get("causes") or ())]
    found = [_line(truth, x) for x in given]
    known = [(offset, angle) for offset, angle in found if offset is not None]
    offset, angle = min(known, key=lambda x: x[0], default=(None, None))
    # An unlisted structure is found if its line is, under whatever name.
    is_there = offset is not None and angle is not None and offset < NEAR_MM and angle < NEAR_DEG
    is_placed = is_there and bool(hidden & set(UNLISTED))
    correct = {
        ADEQUATE: not hidden,
        NAMED: (bool(named) and hidden <= named <= hidden | mounted) or is_placed,
        AMBIGUOUS: (bool(hidden or mounted) and (hidden or mounted) <= group | named) or is_placed,
        UNEXPLAINED: bool(hidden & set(UNLISTED)),
    }.get(verdict, False)
    wrong = is_named and bool(named - hidden - mounted) and not (is_placed and len(named) == 1)
    before, after, covered_before, covered_after = (
        _by_name(diagnosis.get(f"parameters_{x}"))
        for x in ("before", "after", "before_ci95", "after_ci95")
    )
    causes = diagnosis.get("causes") or ()
    answers = [
        _holds(x["ci95"], size)
        for cause in causes
        for name, (size, _) in truth.amplitudes.get(str(cause["name"]), {}).items()
        if (x := (cause.get("parameters") or {}).get(name))
    ]
    return Score(
        verdict=verdict,
        correct=correct,
        wrong=wrong,
        in_group=hidden <= group | named if hidden else None,
        sentence=_sentence(truth, verdict, named, group, correct=correct, wrong=wrong),
        line_offset_mm=offset,
        line_angle_deg=angle,
        amplitudes_covered=float(np.mean(answers)) if answers else None,
        stiffness_error_kN=(_error(truth, before, "_kN"), _error(truth, after, "_kN")),
        strain_error_pct=(_error(truth, before, "_pct"), _error(truth, after, "_pct")),
        covered_before=_coverage(truth, covered_before),
        covered_after=_coverage(truth, covered_after),
    )


def _sentence(
    truth: Truth, verdict: str, named: set[str], group: set[str], *, correct: bool, wrong: bool
) -> str:
    hidden = " and ".join(truth.effects) or "nothing"
    given = " and ".join(sorted(named | group))
    diagnosed = f"{verdict} ({given})" if given else verdict
    judged = "right" if correct else "a wrong name" if wrong else "not right, no wrong name"
    return f"Hidden: {hidden}, signal {truth.signal:.1f}. Diagnosed: {diagnosed}: {judged}."


def _line(truth: Truth, found: Mapping[str, Any] | None) -> tuple[float | None, float | None]:
    """Distance [mm] and angle [deg] of a found line to the true one."""
    if not found or len(truth.lines) != 1:
        return None, None
    (ends,) = truth.lines.values()
    femur, tibia = (np.asarray(found[x], float) for x in ("femur", "tibia"))
    way = _unit(tibia - femur)
    gap = 0.5 * (ends[0] + ends[1]) - femur
    offset = float(np.linalg.norm(gap - (gap @ way) * way))
    cosine = abs(float(way @ _unit(ends[1] - ends[0])))
    return offset, float(np.degrees(np.arccos(min(cosine, 1.0))))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _holds(interval: Sequence[float | None], value: float) -> bool:
    """Whether an interval, whose open ends are None, holds a value."""
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def _by_name(tree: Mapping[str, Mapping[str, Any]] | None) -> dict[str, Any]:
    """Entries by the name of the parameter, from a tree by ligament and quantity."""
    return {
        f"{ligament}.{quantity}": entry
        for ligament, quantities in (tree or {}).items()
        for quantity, entry in quantities.items()
    }


def _error(truth: Truth, found: Mapping[str, float], ending: str) -> float | None:
    errors = [
        abs(found[name] - value)
        for name, value in truth.theta.items()
        if name.endswith(ending) and name in found
    ]
    return float(np.mean(errors)) if errors else None


def _coverage(truth: Truth, intervals: Mapping[str, Sequence[float | None]]) -> float | None:
    answers = [_holds(intervals[name], x) for name, x in truth.theta.items() if name in intervals]
    return float(np.mean(answers)) if answers else None
