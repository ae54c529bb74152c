"""How different two knees may be that a measurement cannot tell apart."""

from collections.abc import Iterable, Iterator, Sequence

from identknee.identify.equivalents import Extrema
from identknee.identify.extremum import End
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.words import amount, between, interval, label, parameter_words
from identknee.verbs.equivalents import Equivalents

STIFFNESS = "stiffness_kN"
MOST_FORCES = 12
# What ends a range as a rule.
USUAL = {End.LIMIT, End.INTERIOR}


def equivalents_statements(answer: Equivalents) -> Iterator[Statement]:
    """The least known stiffness and the sets, then the least known force."""
    region = answer.region
    yield Statement(
        question=Question.KNOWN,
        sentence=" ".join([*_least_known(region.parameters.values()), *_sets(answer)]),
        tables=(_table(region.parameters.values(), "Ranges over all equivalent sets"),),
        is_answer=True,
    )
    forces = _widest_first(region.quantities.values())
    if forces:
        widest, shown = forces[0], forces[:MOST_FORCES]
        several = (
            f" The table lists the {MOST_FORCES} of {len(forces)} forces that differ most."
            * (len(forces) > MOST_FORCES)
        )
        yield Statement(
            question=Question.KNOWN,
            sentence=f"Among such sets, {parameter_words(widest.name)} lies anywhere "
            f"{between(_ends(widest), widest.unit)}.{several}",
            tables=(_table(shown, "Forces that differ most"),),
        )


def _least_known(parameters: Iterable[Extrema]) -> Iterator[str]:
    stiffness = [x for x in parameters if x.name.endswith(STIFFNESS)]
    for x in _widest_first(stiffness)[:1]:
        yield (
            "Two knees that this measurement cannot tell apart may differ by "
            f"{amount(_width(x), x.unit)} in {parameter_words(x.name)} "
            f"({interval(_ends(x), x.unit)})."
        )


def _sets(answer: Equivalents) -> Iterator[str]:
    region = answer.region
    yield (
        f"Among {region.n_sets} such parameter sets the two farthest apart differ by "
        f"{region.farthest:.3g} typical steps (3 kN, 2 %), and the two closest by "
        f"{region.closest:.3g}. {region.sentence}"
    )
    if answer.power_of_best_test is not None:
        yield (
            "Even the best test at the 5 % level tells one of them from the fit in only "
            f"{100 * answer.power_of_best_test:.0f} of 100 measurements."
        )


def _table(ranges: Iterable[Extrema], title: str) -> Table:
    return Table(
        title=title,
        columns=(
            Column(name="quantity"),
            Column(name="lowest", decimals=None),
            Column(name="fit", decimals=None),
            Column(name="highest", decimals=None),
            Column(name="remark"),
        ),
        rows=tuple((label(x.name), x.smallest, x.at_fit, x.largest, _note(x)) for x in ranges),
    )


def _note(x: Extrema) -> str:
    return " ".join(sorted({y.end.sentence for y in (x.lower, x.upper) if y.end not in USUAL}))


def _widest_first(ranges: Iterable[Extrema]) -> Sequence[Extrema]:
    return sorted(ranges, key=lambda x: -_width(x))


def _width(x: Extrema) -> float:
    return x.largest - x.smallest


def _ends(x: Extrema) -> tuple[float, float]:
    return x.smallest, x.largest
