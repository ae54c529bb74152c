"""What a sensitivity analysis says: which parameter moves which laxity most."""

import math
from collections.abc import Iterator

from identknee.identify.sensitivity.sensitivity import Sensitivity
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.words import coordinate_words, label, parameter_words
from identknee.verbs.sensitivity import GlobalSensitivity

METHODS = {"morris": "Morris's elementary effects", "sobol": "Sobol's total index"}
OF_MAIN_INTEREST = {
    "morris": "mu_star",
    "sobol": "ST",
    "delta": "delta",
    "pawn": "pawn",
    "hdmr": "ST",
    "shapley": "shapley",
}
MEANINGS = {
    "morris": "its mean effect (mm or deg) when it alone crosses its whole range",
    "sobol": "the share of the variance that would be left if all others were known",
    "delta": "how much knowing it changes the distribution of the output, 0 to 1",
    "pawn": "how far knowing it shifts the distribution of the output, 0 to 1",
    "hdmr": "the share of the variance that its terms explain",
    "shapley": "its fair share of the variance, with what it shares with others",
}


def sensitivity_statements(answer: GlobalSensitivity) -> Iterator[Statement]:
    """Which parameter moves which laxity most, and how well that is known."""
    found = answer.analysis
    yield _statement(
        f"{_most_influential(found)} The largest index of each parameter is "
        f"{MEANINGS[found.method]}.",
        _table(found),
    )
    missing = found.missing_simulations
    more = f"{missing:.0f} more simulations" if math.isfinite(missing) else "other trials"
    yield _statement(
        f"Of {found.n_simulations} simulations {100 * found.share_failed:.2g} % had a trial "
        f"without prediction. The rule for these: {found.rule}."
        + (f" Half-widths of 0.02 in every group would take about {more}." if missing > 0 else "")
    )


def _statement(sentence: str, *tables: Table) -> Statement:
    return Statement(question=Question.LAXITY, sentence=sentence, tables=tables)


def _most_influential(found: Sensitivity) -> str:
    entries = found.largest[OF_MAIN_INTEREST[found.method]]

    def size(name: str) -> float:
        value = float(entries[name]["largest"]["value"])
        # Unknown where every simulation of a group failed.
        return 0.0 if math.isnan(value) else value

    name = max(entries, key=size)
    coordinate, _, where = str(entries[name]["largest"]["group"]).partition(", ")
    measure = METHODS.get(found.method, f"the {found.method} index")
    return (
        f"By {measure} laxity depends most on {parameter_words(name)}: "
        f"{coordinate_words(coordinate)} at {_place(where)}."
    )


def _place(where: str) -> str:
    """Flexion and load of a group, as a sentence has them."""
    flexion, _, load = where.partition(", ")
    under = "without load" if load == "unloaded" else f"under {load}"
    return f"{flexion} of flexion {under}" if load else where


def _table(found: Sensitivity) -> Table:
    name = OF_MAIN_INTEREST[found.method]
    index = found.indices[name]
    tops = [found.largest_group(name, i) for i in range(found.parameters.n)]
    return Table(
        title="Largest influence of every parameter",
        columns=(
            Column(name="parameter"),
            Column(name=f"index {name}", decimals=3),
            Column(name="half-width", decimals=3),
            Column(name="laxity it moves most"),
            Column(name="index of failure", decimals=3),
        ),
        rows=tuple(
            (
                label(parameter),
                float(index.final[top, i]),
                float(index.final_half_widths[top, i]),
                found.groups[top],
                float(index.final[-1, i]),
            )
            for i, (parameter, top) in enumerate(zip(found.parameters.names, tops, strict=True))
        ),
    )
