"""What results say of fits and sweeps: where searches ended, and what that does not show."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from identknee.report.answers.profile import parameter_statements
from identknee.report.page.results import Result
from identknee.report.page.stored import stored_profiles
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import (
    amount,
    coordinate_words,
    label,
    listed,
    parameter_words,
)
from identknee.runs.outcome import Outcome

# Below this a parameter error is rounding [kN].
EXACT_KN = 1e-6
METHODS = {"morris": "Morris's elementary effects", "sobol": "Sobol's total index"}


def demo_findings(result: Result) -> Iterator[Statement]:
    """What the paper's question comes to: a good fit, wrong parameters, and why."""
    starts = result.summary["starts"]
    searches = [x for x in starts if x["method"] == "complex"]
    descents = [x for x in starts if x["method"] == "least-squares"]
    worst = max(searches, key=lambda x: float(x["error"]["kN"]))
    yield Statement(
        question=Question.SEARCH,
        sentence=f"{misleading_fit(worst)} {exact_fit(descents)}",
        tables=(_starts_table(starts),),
        is_answer=True,
    )
    noise = result.summary.get("noise")
    given = "" if noise is None else f"With noise of {noise['mm']:g} mm and {noise['deg']:g} deg, "
    yield from parameter_statements(stored_profiles(result), given)


def misleading_fit(row: Mapping[str, Any]) -> str:
    """How wrong parameters were that fit well, from what a demo says of one start."""
    error, rmse = row["error"], row["rmse"]
    return (
        f"Complex from {row['start']} ends {error['kN']:.2f} kN and {error['pct']:.2f} % from the "
        f"true parameters on average, and still reproduces the laxity to {rmse['mm']:.2f} mm and "
        f"{rmse['deg']:.2f} deg: that a model fits does not show that its parameters are right."
    )


def exact_fit(rows: Sequence[Mapping[str, Any]]) -> str:
    """How near least squares came from the same starts."""
    largest = max(float(x["error"]["kN"]) for x in rows)
    if largest > EXACT_KN:
        return f"Least squares ends up to {largest:.2g} kN from the true parameters."
    return (
        f"Least squares with exact derivatives finds the true parameters from all {len(rows)} "
        "starts: the wrong sets are places where Complex stopped, not other minima."
    )


def simulate_findings(result: Result) -> Iterator[Statement]:
    """How many trials have an equilibrium."""
    summary = result.summary
    n, total = int(summary["n_converged"]), int(summary["n_trials"])
    lost = [x for x in summary["trials"] if x["outcome"] != "converged"]
    tables: tuple[Table, ...] = ()
    if lost:
        columns = (Column(name="trial"), Column(name="why"))
        rows = tuple((str(x["trial"]), str(x["reason"])) for x in lost)
        tables = (Table(title="Trials without prediction", columns=columns, rows=rows),)
    yield Statement(
        question=Question.LAXITY,
        sentence=f"Of {total} simulated trials {n} have a stable equilibrium.",
        tables=tables,
    )


def fit_findings(result: Result) -> Iterator[Statement]:
    """How well the best fit reproduces the data, and how the search ended."""
    summary = result.summary
    if summary["outcome"] == Outcome.START_FAILED.value:
        # What the search began with is no fit, and its error is that of the other trials.
        yield Statement(question=Question.SEARCH, sentence=str(summary["sentence"]), is_answer=True)
        return
    rmse = summary["rmse"]
    errors = [
        amount(rmse[key], unit)
        for key, unit in (("mm", "mm"), ("deg", "deg"))
        if rmse.get(key) is not None
    ]
    before, after = summary["start_parameters"], summary["parameters"]
    rows = tuple(
        (label(f"{owner}.{name}"), before[owner][name], value)
        for owner, own in after.items()
        for name, value in own.items()
    )
    columns = (
        Column(name="parameter"),
        Column(name="start", decimals=None),
        Column(name="fitted", decimals=None),
    )
    yield Statement(
        question=Question.SEARCH,
        sentence=f"The best fit reproduces the measured laxity to {listed(errors)} on average "
        f"(RMSE). {summary['sentence']} A good fit does not show that its parameters are right.",
        tables=(Table(title="Fitted parameters", columns=columns, rows=rows),),
        is_answer=True,
    )


def sensitivity_findings(result: Result) -> Iterator[Statement]:
    """Which parameter moves which laxity most."""
    indices = result.summary["indices"]
    name = next((x for x in ("mu_star", "ST") if x in indices), next(iter(indices)))
    entries = indices[name]
    rows = tuple(
        (label(x), str(y["largest"]["group"]), y["largest"]["value"]) for x, y in entries.items()
    )
    columns = (
        Column(name="parameter"),
        Column(name="laxity it moves most"),
        Column(name=f"index {name}", decimals=None),
    )
    yield Statement(
        question=Question.LAXITY,
        sentence=_most_influential(entries, str(result.summary["method"])),
        tables=(Table(title="Largest influence of every parameter", columns=columns, rows=rows),),
    )


def _most_influential(entries: Mapping[str, Any], method: str) -> str:
    # Null where every simulation of a group failed.
    name, entry = max(entries.items(), key=lambda x: float(x[1]["largest"]["value"] or 0.0))
    coordinate, _, where = str(entry["largest"]["group"]).partition(", ")
    measure = METHODS.get(method, f"the {method} index")
    return (
        f"By {measure} laxity depends most on {parameter_words(name)}: "
        f"{coordinate_words(coordinate)} at {where.replace(', ', ' of flexion under ')}."
    )


def _starts_table(starts: list[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (
            f"{x['method']} from {x['start']}",
            x["error"]["kN"],
            x["error"]["pct"],
            x["rmse"]["mm"],
            x["rmse"]["deg"],
            int(x["n_simulations"]),
        )
        for x in starts
    )
    return Table(
        title="Fits of noise-free laxity, medians over the runs",
        columns=(
            Column(name="method and start"),
            Column(name="mean error of stiffness", unit="kN"),
            Column(name="mean error of reference strain", unit="%"),
            Column(name="laxity RMSE", unit="mm"),
            Column(name="laxity RMSE", unit="deg"),
            Column(name="simulations"),
        ),
        rows=rows,
    )
