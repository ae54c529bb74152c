"""What results say of the parameters: known within limits, open, or interchangeable."""

from collections.abc import Iterator, Mapping
from typing import Any

from identknee.identify.profile.result import SideStatus, Verdict
from identknee.report.page.finding import Finding, Question
from identknee.report.page.results import Result
from identknee.report.page.words import amount, capital, label, listed, parameter_words
from identknee.report.tables import Column, Table

STIFFNESS = "stiffness_kN"
# More of them in one sentence are no answer any more.
MOST_NAMED = 5
MOST_FORCES = 12
Entries = Mapping[str, Mapping[str, Any]]


def profile_findings(result: Result) -> Iterator[Finding]:
    """What profiles say: how many quantities are known, then one by one."""
    summary = result.summary
    entries: Entries = summary.get("profiles") or summary["parameters"]
    level = next((float(x["level"]) for x in entries.values()), 0.95)
    stiffness = {name: x for name, x in entries.items() if name.endswith(STIFFNESS)}
    others = {name: x for name, x in entries.items() if name not in stiffness}
    noise = summary.get("noise")
    given = "" if noise is None else f"With noise of {noise['mm']:g} mm and {noise['deg']:g} deg, "
    for k, group in enumerate(x for x in (stiffness, others) if x):
        first = [capital(f"{given}{_how_many(entries, level)}")] if k == 0 else []
        yield Finding(
            question=Question.KNOWN,
            sentence=" ".join([*first, _one_by_one(group)]),
            tables=(_profile_table(group, "Values that the data do not exclude"),),
            is_answer=k == 0,
        )
    yield from _predictions(summary.get("quantities") or {})
    if summary.get("assumptions"):
        yield Finding(question=Question.KNOWN, sentence=" ".join(summary["assumptions"]))


def _one_by_one(entries: Entries) -> str:
    """All quantities of a group in one sentence; of many the best known and those left open."""
    chosen = list(entries)
    if len(chosen) > MOST_NAMED:
        ranked = sorted(chosen, key=lambda x: _width(entries[x]))
        is_open = [x for x in ranked if _width(entries[x]) == float("inf")]
        chosen = list(dict.fromkeys([ranked[0], *(is_open or ranked[-1:])]))
    clauses: list[str] = []
    before = None
    for name in chosen:
        quantity = name.rpartition(".")[2]
        words = parameter_words(name)
        if quantity == before:
            words = words.partition("'s ")[0] + "'s"
        clauses.append(f"{words} {_clause(entries[name])}")
        before = quantity
    return capital("; ".join(clauses)) + "."


def _clause(entry: Mapping[str, Any]) -> str:
    """What is known of a quantity, to follow its name.

    Examples
    --------
    >>> _clause({"value": 10.0, "unit": "kN", "lower": 9.0, "upper": None, "verdict": "one_sided"})
    'is not known upwards (at least 9 kN)'
    """
    low, high, unit = entry["lower"], entry["upper"], str(entry["unit"])
    verdict = Verdict(entry["verdict"])
    if verdict is Verdict.MULTIMODAL:
        parts = listed((_between(x, unit) for x in entry["intervals"]), "or")
        return f"lies in one of several separate ranges ({parts})"
    if verdict is Verdict.UNDETERMINED:
        return "is left undecided, as the computation of a limit was not finished"
    if low is not None and high is not None:
        half = amount(0.5 * (high - low), unit, 2)
        return f"is known to within ±{half} ({amount(low, '')} to {amount(high, unit)})"
    if low is not None:
        return f"is not known upwards (at least {amount(low, unit)}{_model_ends(entry)})"
    if high is not None:
        return f"is not known downwards (at most {amount(high, unit)}{_model_ends(entry)})"
    if verdict is Verdict.STRUCTURALLY_SUSPECT:
        return "is not known, and more data of this kind may not help"
    return f"is not known: these data bound it on neither side{_model_ends(entry)}"


def _model_ends(entry: Mapping[str, Any]) -> str:
    """Where the model and not the data ends a set, to follow what the data say; mostly empty."""
    at_boundary = SideStatus.OPEN_AT_FEASIBILITY.value
    places = [
        amount(entry[f"{side}_side"]["reached"], str(entry["unit"]))
        for side in ("lower", "upper")
        if entry.get(f"{side}_status") == at_boundary
    ]
    return f"; the model ends at {listed(places)}" if places else ""


def _width(entry: Mapping[str, Any]) -> float:
    """Of a set relative to its best value; infinite where it is open."""
    if entry["lower"] is None or entry["upper"] is None:
        return float("inf")
    return float(entry["upper"] - entry["lower"]) / max(abs(float(entry["value"])), 1e-12)


def sample_findings(result: Result) -> Iterator[Finding]:
    """What a sample of the posterior says."""
    entries: Entries = result.summary["parameters"]
    table = Table(
        title="Posterior of the parameters",
        columns=(
            *(Column(name=x, decimals=None) for x in ("parameter", "mean", "sd", "2.5 %")),
            *(Column(name=x, decimals=None) for x in ("97.5 %", "R-hat", "effective draws")),
        ),
        rows=tuple(
            (label(name), *(x[key] for key in ("mean", "sd", "q025", "q975", "rhat", "ess_bulk")))
            for name, x in entries.items()
        ),
    )
    said = f"Given the stated assumptions before the data, {_probable(entries)}." if entries else ""
    yield Finding(
        question=Question.KNOWN,
        sentence=f"{said} {_trusted(result)}".strip(),
        tables=(table,) if entries else (),
    )


def _trusted(result: Result) -> str:
    """Whether the sample may be relied on."""
    summary = result.summary
    if summary["outcome"] == "converged":
        return "Independent samplers agree on it."
    return f"Do not rely on it yet: {summary['sentence']}"


def information_findings(result: Result) -> Iterator[Finding]:
    """Whether the data could determine every parameter, and which are alike."""
    summary = result.summary
    pairs = [x for x in summary["collinear"] if len(x["parameters"]) == 2]
    alike = ""
    if pairs:
        words = listed(map(parameter_words, pairs[0]["parameters"]))
        alike = f" Hardest to tell apart are {words}."
    table = Table(
        title="Combinations of parameters, from well to badly known",
        columns=(
            Column(name="combination, in scaled units"),
            Column(name="eigenvalue", decimals=None),
            Column(name="noise floor", decimals=None),
        ),
        rows=tuple((x["combination"], x["value"], x["floor"]) for x in summary["eigenvalues"]),
    )
    yield Finding(
        question=Question.KNOWN,
        sentence=f"{summary['structure']['sentence']}{alike}",
        tables=(table,),
    )


def equivalents_findings(result: Result) -> Iterator[Finding]:
    """How different two knees may be that the measurement cannot tell apart."""
    summary = result.summary
    stiffness = {n: x for n, x in summary["parameters"].items() if n.endswith(STIFFNESS)}
    for name, entry in _widest_first(stiffness)[:1]:
        yield Finding(
            question=Question.KNOWN,
            sentence="Two knees that this measurement cannot tell apart may differ by "
            f"{amount(entry['upper'] - entry['lower'], entry['unit'])} in "
            f"{parameter_words(name)}: {_between(_range(entry), entry['unit'])}.",
            tables=(_range_table(summary["parameters"], "Ranges over all equivalent sets"),),
            is_answer=True,
        )
    forces = _widest_first(summary["quantities"])[:MOST_FORCES]
    for name, entry in forces[:1]:
        limits = _between(_range(entry), entry["unit"])
        yield Finding(
            question=Question.KNOWN,
            sentence=f"Among them {parameter_words(name)} is anywhere {limits}.",
            tables=(_range_table(dict(forces), "Forces that differ most"),),
        )


def _widest_first(entries: Entries) -> list[tuple[str, Mapping[str, Any]]]:
    """By the size of their ranges; without those of which an end was not found."""
    known = [x for x in entries.items() if None not in (x[1]["lower"], x[1]["upper"])]
    return sorted(known, key=lambda x: float(x[1]["lower"] - x[1]["upper"]))


def _how_many(entries: Entries, level: float) -> str:
    n = len(entries)
    k = sum(x["lower"] is not None and x["upper"] is not None for x in entries.values())
    said = f"ligament parameter{'' if n == 1 else 's'} asked for on both sides"
    which = "" if k == n and n > 1 else f"{k or 'none'} of "
    return f"at {100 * level:g} % confidence the data bound {which}the {n} {said}."


def _predictions(entries: Entries) -> Iterator[Finding]:
    """Forces and laxities, the widest first and the rest behind it."""
    if not entries:
        return
    yield Finding(
        question=Question.KNOWN,
        sentence=_one_by_one(entries),
        tables=(_profile_table(entries, "Forces and laxities that the data do not exclude"),),
    )


def _profile_table(entries: Entries, title: str) -> Table:
    return Table(
        title=title,
        columns=(
            Column(name="quantity"),
            Column(name="lower end", decimals=None),
            Column(name="best", decimals=None),
            Column(name="upper end", decimals=None),
            Column(name="verdict"),
            Column(name="simulations"),
        ),
        rows=tuple(
            (
                label(name),
                _shown_end(x, "lower"),
                x["value"],
                _shown_end(x, "upper"),
                str(x["verdict"]).replace("_", " "),
                int(x["n_simulations"]),
            )
            for name, x in entries.items()
        ),
    )


def _shown_end(entry: Mapping[str, Any], side: str) -> float | str:
    """An end of a set as a table shows it."""
    if entry[side] is not None:
        return float(entry[side])
    if entry.get(f"{side}_status") == SideStatus.OPEN_AT_FEASIBILITY.value:
        return f"open, the model ends at {entry[f'{side}_side']['reached']:.4g}"
    return "open"


def _range_table(entries: Entries, title: str) -> Table:
    return Table(
        title=title,
        columns=(
            Column(name="quantity"),
            Column(name="lowest", decimals=None),
            Column(name="fit", decimals=None),
            Column(name="highest", decimals=None),
        ),
        rows=tuple((label(n), x["lower"], x["fit"], x["upper"]) for n, x in entries.items()),
    )


def _probable(entries: Entries) -> str:
    """Of at most so many parameters, the widest stiffnesses where there are any."""
    names = [x for x in entries if x.endswith(STIFFNESS)] or list(entries)
    parts = []
    for name in names[:MOST_NAMED]:
        unit = "kN" if name.endswith("_kN") else "%" if name.endswith("_pct") else ""
        low, high = entries[name]["q025"], entries[name]["q975"]
        parts.append(f"{parameter_words(name)} is {_between((low, high), unit)}")
    return f"with 95 % probability {listed(parts)}"


def _range(entry: Mapping[str, Any]) -> tuple[float, float]:
    return float(entry["lower"]), float(entry["upper"])


def _between(ends: Any, unit: str) -> str:
    low, high = ends
    if low is None or high is None:
        start = "any value" if low is None else f"from {amount(low, unit)}"
        return f"{start} upwards" if high is None else f"up to {amount(high, unit)}"
    return f"from {amount(low, '')} to {amount(high, unit)}"
