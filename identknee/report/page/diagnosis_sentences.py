"""What results say of the model: what it gets wrong, why, and which tests would tell more."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from identknee.diagnosis.explanations.verdict import Verdict
from identknee.report.page.results import Result
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import (
    amount,
    capital,
    coordinate_words,
    label,
    listed,
    parameter_words,
    trial_words,
)

HYPOTHESIS = "On a real knee this name is a hypothesis that has yet to be tested."
MOST_PARAMETERS = 3


def diagnosis_findings(result: Result) -> Iterator[Statement]:
    """The verdict, where the misfit is, what the cause changes, and the trials that would tell."""
    summary = result.summary
    if "verdict" not in summary:
        yield from _planned(summary)
        return
    verdict = Verdict(summary["verdict"])
    yield Statement(
        question=Question.WRONG,
        sentence=_verdict_sentence(verdict, summary),
        tables=_verdict_tables(summary),
        is_answer=True,
    )
    if summary.get("misfit") and summary["misfit"]["cells"]:
        yield _where(summary["misfit"])
    gain = summary.get("gain")
    # Null where no trial could be held out.
    if gain and gain["rmse_held_out"]["after"]["noise"] is not None:
        yield _gain(gain)
    if summary.get("parameters_before"):
        yield _change(summary)
    if summary.get("noise"):
        yield Statement(question=Question.WRONG, sentence=summary["noise"]["sentence"])
    yield _tried(summary["effects"])
    advised = summary["advised_trials"]
    if advised:
        yield Statement(
            question=Question.NEXT,
            sentence=f"Next test: {_trials(advised)}. {_told(summary['advice'])}",
            tables=(_trial_table(advised),),
            is_answer=True,
        )


def design_findings(result: Result) -> Iterator[Statement]:
    """The trials that shrink open intervals most, and by how much."""
    summary = result.summary
    trials = summary["trials"]
    targets = summary["targets"]
    rows = tuple(
        (label(name), *(_ends(x[when]) for when in ("before", "predicted", "after")))
        for name, x in targets.items()
    )
    columns = tuple(Column(name=x) for x in ("target", "now", "predicted", "simulated"))
    name, entry = next(iter(targets.items()))
    yield Statement(
        question=Question.NEXT,
        sentence=f"Next test for {listed(map(parameter_words, targets))}: {_trials(trials)}. "
        f"{capital(parameter_words(name))} would then be known from {_ends(entry['after'])} "
        f"instead of {_ends(entry['before'])} {entry['before']['unit']}.",
        tables=(
            Table(title="Intervals of the targets", columns=columns, rows=rows),
            _trial_table(trials),
        ),
        is_answer=True,
    )


def _verdict_sentence(verdict: Verdict, summary: Mapping[str, Any]) -> str:
    causes = summary["causes"]
    if verdict is Verdict.NAMED:
        means = " ".join(str(x["meaning"]) for x in causes)
        sizes = listed(_size(x) for x in causes)
        return (
            "The data show something the model lacks, and only one known cause fits: "
            f"{listed(x['name'] for x in causes)}. {means} Its size is {sizes}. {HYPOTHESIS}"
        )
    if verdict is Verdict.AMBIGUOUS:
        names = listed(summary["group"], "or")
        said = [str(summary["sentence"]), *([f"It may be {names}."] if names else [])]
        return " ".join([*said, *untested_reasons(summary)])
    line = summary.get("line")
    if verdict is Verdict.UNEXPLAINED and line:
        return f"{summary['sentence']} {line['sentence']}"
    if verdict is Verdict.NOT_TESTABLE:
        return " ".join([verdict.sentence, *summary["reasons"]])
    return " ".join([str(summary["sentence"]), *untested_reasons(summary)])


def untested_reasons(summary: Mapping[str, Any]) -> list[str]:
    """Why causes could not be tested that may be the explanation."""
    return [
        str(x["reason"])
        for x in summary["rivals"]
        if x.get("reason") and x.get("could_matter", True)
    ]


def _size(cause: Mapping[str, Any]) -> str:
    low, high = cause["ci95"]
    value = amount(cause["amplitude"], cause["unit"])
    if low is None and high is None:
        return f"{value} (95 % open to both sides)"
    if low is None:
        return f"{value} (95 % open below, up to {amount(high, cause['unit'])})"
    if high is None:
        return f"{value} (95 % from {amount(low, cause['unit'])}, open above)"
    return f"{value} (95 % from {amount(low, '')} to {amount(high, cause['unit'])})"


def _verdict_tables(summary: Mapping[str, Any]) -> tuple[Table, ...]:
    known = summary.get("p_value") is not None
    tables = [_sizes(summary["causes"]), _compared(summary["rivals"])]
    return tuple(x for x in (*tables, *([_clarity(summary)] if known else [])) if x.rows)


def _sizes(causes: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (f"{cause['name']}, {label(name)}", x["value"], *map(_end, x["ci95"]))
        for cause in causes
        for name, x in cause["parameters"].items()
    )
    columns = (
        Column(name="amplitude"),
        Column(name="value", decimals=None),
        Column(name="95 % from", decimals=None),
        Column(name="to", decimals=None),
    )
    return Table(title="Size of the cause", columns=columns, rows=rows)


def _compared(rivals: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (
            listed(x["causes"]) or "no cause",
            x["log_evidence_below"],
            x["distance"],
            str(x.get("state") or ("excluded" if x.get("is_excluded") else "open")),
        )
        for x in rivals
    )
    columns = (
        Column(name="other explanation"),
        Column(name="log evidence below", decimals=1),
        Column(name="distance", unit="sd of the noise", decimals=1),
        Column(name="state"),
    )
    return Table(title="What else was compared", columns=columns, rows=rows)


def _clarity(summary: Mapping[str, Any]) -> Table:
    misfit = summary["misfit"]
    rows = (
        ("probability of a misfit as clear by noise alone", summary["p_value"]),
        ("chi-square without the cause", misfit["chi_square_before"]),
        ("chi-square with the cause", misfit["chi_square_after"]),
        ("measured values", misfit["n_measured"]),
    )
    columns = (Column(name="test"), Column(name="value", decimals=None))
    return Table(title="How clear it is", columns=columns, rows=rows)


def _where(misfit: Mapping[str, Any]) -> Statement:
    cells = misfit["cells"]
    angles: dict[tuple[str, str], list[str]] = {}
    for x in cells:
        place = coordinate_words(x["coordinate"]), str(x["direction"])
        angles.setdefault(place, []).append(f"{x['flexion_deg']:g}")
    places = listed(
        f"{coordinate} under {direction} at {listed(own)} deg of flexion"
        for (coordinate, direction), own in angles.items()
    )
    rows = tuple(
        (label(x["coordinate"]), x["flexion_deg"], x["direction"], x["score"], x["p_value"])
        for x in cells
    )
    columns = (
        Column(name="coordinate"),
        Column(name="flexion", unit="deg", decimals=0),
        Column(name="load"),
        Column(name="score", decimals=1),
        Column(name="p", decimals=None),
    )
    return Statement(
        question=Question.WRONG,
        sentence=f"It is wrong mostly in {places}: "
        f"{100 * misfit['share']:.0f} % of the misfit beyond the noise.",
        tables=(Table(title="Cells that stand out", columns=columns, rows=rows),),
        is_answer=True,
    )


def _gain(gain: Mapping[str, Any]) -> Statement:
    held, expected = gain["rmse_held_out"], gain["rmse_held_out_expected"]
    names = {
        "before": "without the cause",
        "after": "with the cause",
        "absorbed": "with a Gaussian process that explains nothing",
    }
    rows = tuple(
        (words, *(held[key][x] for x in ("mm", "deg", "noise")), expected[key]["noise"])
        for key, words in names.items()
    )
    columns = (
        Column(name="model"),
        Column(name="error", unit="mm"),
        Column(name="error", unit="deg"),
        Column(name="error", unit="sd of the noise"),
        Column(name="expected of a right model", unit="sd of the noise"),
    )
    return Statement(
        question=Question.WRONG,
        sentence="With the cause the model predicts trials it has not seen with an error of "
        f"{held['after']['noise']:.2f} instead of {held['before']['noise']:.2f} times the noise.",
        tables=(Table(title="Errors of trials held out", columns=columns, rows=rows),),
    )


def _change(summary: Mapping[str, Any]) -> Statement:
    before, after = summary["parameters_before"], summary["parameters_after"]
    spans = summary["parameters_before_ci95"], summary["parameters_after_ci95"]
    rows, moves = [], {}
    for owner, own in before.items():
        for name, value in own.items():
            whole, new = f"{owner}.{name}", after[owner][name]
            old, own_after = spans[0][owner][name], spans[1][owner][name]
            moves[whole] = abs(new - value) / _width(old)
            rows.append((label(whole), value, *map(_end, old), new, *map(_end, own_after)))
    most = sorted(moves, key=lambda x: -moves[x])[:MOST_PARAMETERS]
    columns = tuple(
        Column(name=x, decimals=2)
        for x in ("parameter", "without", "95 % from", "to", "with", "95 % from", "to")
    )
    sentence = "These are the ligaments' parameters by the model as it is."
    if summary["causes"]:
        words = listed(map(parameter_words, most))
        sentence = f"With the cause the ligaments' parameters change, most of all {words}."
    return Statement(
        question=Question.WRONG,
        sentence=sentence,
        tables=(
            Table(title="Parameters without and with the cause", columns=columns, rows=tuple(rows)),
        ),
    )


def _width(ends: Sequence[float | None]) -> float:
    """Width of an interval, for ranking; infinite where it is open."""
    low, high = ends
    return float("inf") if low is None or high is None else max(high - low, 1e-12)


def _end(end: float | None) -> float | str:
    return "open" if end is None else end


def _tried(effects: Mapping[str, Mapping[str, Any]]) -> Statement:
    missed = [name for name, x in effects.items() if x["cell"] == "inconclusive"]
    rows = tuple(
        (
            name,
            str(x["cell"]),
            x["score"],
            "never" if x["detectable"] is None else amount(x["detectable"], x["unit"]),
            amount(x["relevant"], x["unit"]),
        )
        for name, x in effects.items()
    )
    columns = (
        Column(name="cause"),
        Column(name="state"),
        Column(name="score", decimals=1),
        Column(name="seen from"),
        Column(name="would matter from"),
    )
    said = f"{len(effects)} known causes were tried."
    if missed:
        said += f" The data could not have shown {listed(missed)} at a size that matters."
    return Statement(
        question=Question.WRONG,
        sentence=said,
        tables=(Table(title="Every cause tried", columns=columns, rows=rows),),
    )


def _planned(summary: Mapping[str, Any]) -> Iterator[Statement]:
    """What a protocol could show, before there are data."""
    rows = tuple(
        (
            name,
            "never" if x["detectable"] is None else amount(x["detectable"], x["unit"]),
            amount(x["relevant"], x["unit"]),
            listed(summary["look_alikes"].get(name, [])) or "-",
        )
        for name, x in summary["effects"].items()
    )
    names = ("cause", "seen from", "would matter from", "looks like")
    table = Table(
        title="What these trials could show",
        columns=tuple(Column(name=x) for x in names),
        rows=rows,
    )
    groups = summary["groups"]
    together = "; ".join(listed(x["effects"], "from") for x in groups)
    yield Statement(
        question=Question.WRONG,
        sentence=f"The {summary['n_trials']} trials of {summary['protocol']} could not tell "
        f"{together}."
        if groups
        else f"The {summary['n_trials']} trials of {summary['protocol']} tell all causes apart.",
        tables=(table,),
        is_answer=True,
    )
    for group in groups:
        if group["advised_trials"]:
            yield Statement(
                question=Question.NEXT,
                sentence=f"To tell {listed(group['effects'])} apart, add "
                f"{_trials(group['advised_trials'])}.",
                tables=(_trial_table(group["advised_trials"]),),
            )


def _trials(trials: Sequence[Mapping[str, Any]]) -> str:
    counts: dict[str, int] = {}
    for trial in trials:
        words = trial_words(trial)
        counts[words] = counts.get(words, 0) + 1
    return listed(x if n == 1 else f"{x} ({n} times)" for x, n in counts.items())


def _told(advice: Mapping[str, Any] | None) -> str:
    return "" if advice is None else str(advice["sentence"])


def _trial_table(trials: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        title="Trials to add, the most telling first",
        columns=(Column(name="trial"), Column(name="what to do")),
        rows=tuple((str(x["trial"]), trial_words(x)) for x in trials),
    )


def _ends(entry: Mapping[str, Any]) -> str:
    low, high = (
        "open" if entry[x] is None else f"{float(entry[x]):.3g}" for x in ("lower", "upper")
    )
    return f"{low} to {high}"
