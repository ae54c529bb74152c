"""A diagnosis as sentences and tables for a person."""

from collections.abc import Iterable, Sequence

from identknee.diagnosis.advice.advice import Advice
from identknee.diagnosis.diagnose import Diagnosis
from identknee.diagnosis.explanations.attribution import Attribution
from identknee.diagnosis.explanations.candidates import Exclusion, Visibility
from identknee.diagnosis.explanations.causes import (
    Cause,
    Estimate,
    ligament_estimates,
)
from identknee.diagnosis.explanations.refit import Refit, Rival, RivalState
from identknee.diagnosis.explanations.verdict import Verdict
from identknee.diagnosis.gain.gain import Gain
from identknee.diagnosis.score.score import Cell
from identknee.model.effects.facts import FACTS

MOST_RIVALS = 6


def diagnosis_lines(found: Diagnosis) -> dict[str, list[str]]:
    """What a person reads, lines by heading."""
    conclusion, explanation = found.conclusion, found.explanation
    is_named = conclusion.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    heading = conclusion.verdict.value
    if explanation.causes:
        is_open = conclusion.verdict is Verdict.AMBIGUOUS
        heading += ": " + (" or ".join(conclusion.group) if is_open else listed(explanation.names))
    sections = {
        heading: [conclusion.sentence, *conclusion.reasons, found.noise.sentence],
        "Where": [] if conclusion.verdict is Verdict.ADEQUATE else [found.localisation.sentence],
        "Cause": [x for cause in found.causes for x in _cause(cause)],
        "Where it would act": [] if found.line is None else [found.line.sentence],
        "Rivals": _rivals(found.attribution) if is_named else [],
        "Whichever of them it is": _whichever(found) if is_named else [],
        "What would tell them apart": _advice(found.advice),
        "Excluded, and beyond the power of these data": _tested(found.exclusions, conclusion.group),
        "Gain": [] if found.gain is None else _gain(found.gain),
        "Parameters": _parameters(found),
    }
    return {heading: lines for heading, lines in sections.items() if lines}


def listed(words: Iterable[str]) -> str:
    """Words as in a sentence.

    Examples
    --------
    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    *most, last = [*words] or [""]
    return f"{', '.join(most)} and {last}" if most else last


def amount(value: float, unit: str) -> str:
    """A number with its unit.

    Examples
    --------
    >>> amount(0.7766, "kN"), amount(0.08, "1")
    ('0.777 kN', '0.08')
    """
    return f"{value:.3g}" + ("" if unit == "1" else f" {unit}")


def visibility_line(x: Visibility) -> str:
    """Which size of an effect is seen, and which would matter."""
    seen = "never" if x.detectable == float("inf") else f"from {amount(x.detectable, x.unit)} on"
    return f"seen {seen}; {amount(x.relevant, x.unit)} would matter ({x.parameter})"


def _cause(cause: Cause) -> list[str]:
    size = cause.amplitude
    lines = [
        f"{cause.name}: {_shown(size)} ({size.name})",
        f"  {FACTS[cause.name].sentence}",
        f"  Plausible: {FACTS[cause.name].source}.",
    ]
    others = [x for x in cause.parameters if x is not size]
    if others:
        lines.append("  " + "; ".join(f"{x.name} {_shown(x)}" for x in others))
    return lines


def _shown(estimate: Estimate) -> str:
    low, high = estimate.ci95
    value = amount(estimate.value, estimate.unit)
    if low is None and high is None:
        return f"{value}, 95 % open to both sides"
    if low is None:
        return f"{value}, 95 % open below, up to {high:.3g}"
    if high is None:
        return f"{value}, 95 % from {low:.3g}, open above"
    return f"{value}, 95 % {low:.3g} to {high:.3g}"


def _rivals(attribution: Attribution) -> list[str]:
    untested = [x for x in attribution.rivals if x.state is RivalState.NOT_TESTED]
    tested = [x for x in attribution.rivals if x not in untested]
    rivals = [*tested[:MOST_RIVALS], *untested]
    if not rivals:
        return ["No other cause came near."]
    width = max(len(listed(x.refit.names)) for x in rivals)
    rows = [f"{'':{width}}  log evidence  distance", *(_rival(x, width) for x in rivals)]
    # Those that may matter are among the reasons of the verdict.
    return rows + [x.reason for x in untested if not x.could_matter]


def _rival(rival: Rival, width: int) -> str:
    name = listed(rival.refit.names) or "no cause"
    if rival.state is RivalState.NOT_TESTED:
        return f"{name:{width}}  {'-':>12}  {'-':>8}  {rival.state}"
    return (
        f"{name:{width}}  {-rival.log_evidence_deficit:12.1f}  {rival.distance:8.1f}  {rival.state}"
    )


def _advice(advice: Advice | None) -> list[str]:
    if advice is None:
        return []
    before, after = float(advice.before.min()), float(advice.after.min())
    trials = [f"{i}. {name}" for i, name in enumerate(advice.trials.trials, 1)]
    sentence = (
        f"With these trials added the nearest rival would be {after:.1f} units of noise away "
        f"instead of {before:.1f}; 5 are enough."
    )
    return [*trials, sentence]


def _whichever(found: Diagnosis) -> list[str]:
    """What the ligaments' parameters are under every explanation that is open."""
    rivals = found.attribution.open_rivals
    if not rivals:
        return []
    trees = [_flat(x.refit) for x in rivals]
    lines = []
    for name, best in _flat(found.explanation).items():
        values = [best.value, *(x[name].value for x in trees)]
        low, high = best.ci95
        # Beyond an open end nothing is said.
        is_free = (low is None or low <= min(values)) and (high is None or max(values) <= high)
        lines.append(
            f"{name}: {min(values):.2f} to {max(values):.2f}"
            + ("" if is_free else ", which depends on the cause")
        )
    return lines


def _tested(tested: Sequence[Exclusion], named: Sequence[str]) -> list[str]:
    others = [x for x in tested if x.name not in named]
    width = max((len(x.name) for x in others), default=0)
    lines = []
    for cell in Cell:
        own = [x for x in others if x.cell is cell]
        if own:
            lines.append(f"{cell.value}: {cell.sentence}")
        lines += [f"  {x.name:{width}}  {visibility_line(x)}" for x in own]
    return lines


def _gain(gain: Gain) -> list[str]:
    before, after = (gain.rmse_held_out(x).noise for x in (gain.before, gain.after))
    absorbed = gain.rmse_held_out(gain.absorbed).noise
    errors = (
        f"Error of trials held out, in units of the noise: {before:.2f} before, {after:.2f} with "
        f"the cause, {absorbed:.2f} with a Gaussian process that absorbs the misfit unnamed."
    )
    density = f"{gain.elpd.difference:+.1f} +- {gain.elpd.se:.1f} nats"
    return [errors, f"Log predictive density of trials held out: {density}."]


def _parameters(found: Diagnosis) -> list[str]:
    before = _flat(found.base)
    after = _flat(found.explanation)
    width = max(len(x) for x in before)
    lines = [f"{'':{width}}  {'without cause':>26}  {'with cause':>26}"]
    if not found.explanation.causes:
        lines, after = [f"{'':{width}}  {'fitted, 95 %':>26}"], {}
    return lines + [
        f"{name:{width}}  {_interval(x):>26}"
        + (f"  {_interval(after[name]):>26}" if name in after else "")
        for name, x in before.items()
    ]


def _flat(refit: Refit) -> dict[str, Estimate]:
    tree = ligament_estimates(refit)
    return {f"{owner}.{x.name}": x for owner, own in tree.items() for x in own.values()}


def _interval(x: Estimate) -> str:
    low, high = ("open" if end is None else f"{end:.2f}" for end in x.ci95)
    return f"{x.value:.2f} ({low} to {high})"
