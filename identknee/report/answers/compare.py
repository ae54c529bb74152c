"""What results say side by side: where they exclude one another, and in what they differ."""

from collections.abc import Iterator, Sequence

import numpy as np
from typing_extensions import override

from identknee.checks.fit_checks import SAME
from identknee.report.comparison import ComparedQuantity, Comparison, compared_values
from identknee.report.presenter import Drawing, Presenter, Statement, Table, table
from identknee.runs.findings import Doubt
from identknee.runs.words import label, label_without_unit, listed, listed_first, unit_of
from identknee.subject.knee import Knee

# Forces and predictions in a figure and a table, those that differ most.
MOST_FORCES, MOST_NAMED = 8, 3
NO_SETS = (
    "Fewer than two results have an interval of the same parameter: whether they exclude one "
    "another is not known. Profiles or a sample would show it."
)


def _side_by_side(title: str, names: Sequence[str], given: Sequence[ComparedQuantity]) -> Table:
    return table(
        title,
        ("quantity", *names, "sets"),
        (
            (
                label_without_unit(x.name),
                *compared_values(x, names),
                "apart" if x.is_apart else "",
            )
            for x in given
        ),
    )


def _tidy(given: Sequence[ComparedQuantity]) -> Table:
    """One row for each quantity and result, with numbers alone in its columns."""
    ends = [(x, None) for x in ("estimate", "lower end", "upper end")]
    return table(
        "Values one by one",
        ("quantity", "result", "unit", *ends, "method", "status"),
        (
            (
                *(label_without_unit(x.name), y.name, unit_of(x.name)),
                *(y.estimate, y.lower, y.upper, y.method, y.status),
            )
            for x in given
            for y in x.stands
        ),
    )


def _misfit_tables(answer: Comparison) -> Iterator[Table]:
    terms = list(dict.fromkeys(x.name for own in answer.misfits for x in own.terms))
    by_name = [{x.name: x.deviance for x in own.terms} for own in answer.misfits]
    rows = [
        ("RMSE [mm]", *(x.rmse_mm for x in answer.misfits)),
        ("RMSE [deg]", *(x.rmse_deg for x in answer.misfits)),
        ("deviance", *(x.deviance for x in answer.misfits)),
        *((f"of it: {term}", *(x.get(term) for x in by_name)) for term in terms if len(terms) > 1),
        ("parameters fitted", *(x.n_fitted for x in answer.misfits)),
        ("log evidence", *(x.log_evidence for x in answer.misfits)),
    ]
    known = [row for row in rows if any(x is not None for x in row[1:])]
    if known:
        yield table("Misfit side by side", ("measure", *((x, None) for x in answer.names)), known)


def _misfit_sentence(answer: Comparison) -> str:
    found = {x.name: x.data_deviance for x in answer.misfits}
    deviances = {name: x for name, x in found.items() if x is not None}
    if not answer.is_misfit_comparable:
        return f"Misfit and evidence are not compared: {answer.why_not}."
    if len(deviances) < 2:
        return "Data and noise are the same, but fewer than two results have a deviance."
    lowest = min(deviances, key=lambda x: deviances[x])
    if max(deviances.values()) - deviances[lowest] <= SAME:
        return f"With the same data and noise, {listed(deviances)} leave the same deviance."
    others = [
        f"{name} by {value - deviances[lowest]:.3g}"
        for name, value in deviances.items()
        if name != lowest
    ]
    text = f"With the same data and noise, {lowest} leaves the lowest deviance of the data; "
    text += f"it is higher in {listed(others)}."
    logs = {x.name: x.log_evidence for x in answer.misfits if x.log_evidence is not None}
    if len(logs) > 1:
        best = max(logs, key=lambda x: logs[x])
        lower = [f"{name} by {logs[best] - x:.3g}" for name, x in logs.items() if name != best]
        text += f" The log evidence is highest for {best}, and lower for {listed(lower)}."
    return text


def _laxity_table(answer: Comparison) -> Iterator[Table]:
    far = answer.laxity_difference[1:]
    if np.isfinite(far).any():
        yield table(
            f"Predicted laxity, difference from {answer.names[0]} (root mean square)",
            ("result", *((label(x), 2) for x in answer.coordinate_names), "trials"),
            (
                (name, *row.tolist(), n)
                for name, row, n in zip(
                    answer.names[1:], far, answer.n_trials_shared[1:], strict=True
                )
            ),
        )


def _doubts(answer: Comparison) -> Iterator[str]:
    """Which results have sets that hold no further than their fit."""
    for doubt in Doubt:
        stands = (y for x in answer.parameters for y in x.stands if y.status == doubt.value)
        if own := list(dict.fromkeys(y.name for y in stands)):
            yield f"Sets of {listed(own)} are {doubt.value}, and hold no further than that fit."


class ComparisonPresenter(Presenter[Comparison]):
    """How results side by side are shown."""

    @override
    def statements(self, answer: Comparison) -> Iterator[Statement]:
        """Which sets exclude one another, misfit, predictions, and what differs beside them."""
        apart = [label_without_unit(x.name) for x in answer.parameters if x.is_apart]
        sets = [x for x in answer.parameters if sum(y.has_set for y in x.stands) > 1]
        text = f"{len(answer.names)} results side by side: {listed(answer.names)}."
        if apart:
            text += (
                f" Their 95 % sets of {listed_first(apart, MOST_NAMED)} have no value in common."
            )
        elif sets:
            which = "one parameter" if len(sets) == 1 else f"{len(sets)} parameters"
            text += f" All 95 % sets of {which} overlap."
        else:
            text += f" {NO_SETS}"
        text += "".join(f" {x}" for x in _doubts(answer))
        yield self.say(
            text,
            _side_by_side("Parameters side by side", answer.names, answer.parameters),
            _tidy(answer.quantities),
            is_answer=True,
        )
        verdicts = [x for x in answer.items if x.verdict]
        if verdicts:
            causes = [f" ({listed(x.causes)})" if x.causes else "" for x in verdicts]
            said = (f"{x.name}: {x.verdict}{y}" for x, y in zip(verdicts, causes, strict=True))
            yield self.say(f"Verdicts of the diagnoses: {listed(said)}.")
        yield self.say(_misfit_sentence(answer), *_misfit_tables(answer), is_answer=True)
        for words, given in (("forces", answer.forces), ("predictions", answer.predictions)):
            if given:
                first = given[0]
                yield self.say(
                    f"Of {len(given)} {words}, {label_without_unit(first.name)} differs most "
                    f"(by {first.spread:.3g} {unit_of(first.name)}).",
                    _side_by_side(
                        f"{words.capitalize()} that differ most",
                        answer.names,
                        given[:MOST_FORCES],
                    ),
                )
        tables = tuple(_laxity_table(answer))
        if tables:
            yield self.say(
                "The predicted laxity was compared over the trials that both have.", *tables
            )
        if answer.differences:
            what = listed(x.what for x in answer.differences)
            yield self.say(
                f"The results differ in {what}.",
                table(
                    "What differs beside the numbers",
                    ("part", *answer.names),
                    ((x.what, *x.values) for x in answer.differences),
                ),
                is_answer=True,
            )

    @override
    def drawings(self, answer: Comparison, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        """A forest plot of parameters, one of what differs most of forces, and the misfit."""
        from identknee.report.parameter_figures import deviance_figure, forest_figure

        names = listed(answer.names)
        for name, given in (
            ("parameters", answer.parameters),
            ("forces", answer.forces[:MOST_FORCES]),
            ("predictions", answer.predictions[:MOST_FORCES]),
        ):
            if given:
                yield Drawing(
                    name=name,
                    figure=forest_figure(given, answer.names),
                    caption=f"{name.capitalize()} of {names}: estimates with their 95 % sets. An "
                    "arrow marks an open end; a mark alone has no interval.",
                    description=f"Forest plot of {len(given)} {name} of {names}.",
                )
        known = [x for x in answer.misfits if x.terms]
        if answer.is_misfit_comparable and len(known) > 1:
            yield Drawing(
                name="deviance",
                figure=deviance_figure(known),
                caption="Deviance of the best fits by its terms; the data and the noise are the "
                "same.",
                description=f"Deviance by term of {listed(x.name for x in known)}.",
            )
