"""How different two knees may be that a measurement cannot distinguish."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from typing_extensions import override

from identknee.identify.equivalents import Extrema
from identknee.identify.region import ExtremumEnd
from identknee.laxity.table import COORDINATES
from identknee.report.presenter import (
    SDS_95,
    Band,
    Drawing,
    Presenter,
    Range,
    Source,
    Statement,
    Table,
    table,
)
from identknee.runs.words import (
    amount,
    between,
    interval,
    label,
    label_without_unit,
    listed,
    parameter_words,
)
from identknee.subject.knee import Knee
from identknee.verbs.equivalents import Equivalents

STIFFNESS = "stiffness_kN"
MOST_FORCES = 12
# Forces in a figure.
MOST_DRAWN = 16
FORCE_UNIT = "N"
# Other predictions in a sentence.
MOST_NAMED = 2
# What ends a range as a rule.
USUAL = {ExtremumEnd.LIMIT, ExtremumEnd.INTERIOR}


def _table(ranges: Iterable[Extrema], title: str) -> Table:
    return table(
        title,
        ("quantity", ("lowest", None), ("fit", None), ("highest", None), "remark"),
        (
            (
                label(x.name),
                x.smallest,
                x.at_fit,
                x.largest,
                " ".join(
                    sorted({y.end.sentence for y in (x.lower, x.upper) if y.end not in USUAL})
                ),
            )
            for x in ranges
        ),
    )


def _widest_first(ranges: Iterable[Extrema]) -> Sequence[Extrema]:
    return sorted(ranges, key=lambda x: -_width(x))


def _forces(ranges: Iterable[Extrema]) -> Iterator[Extrema]:
    return (x for x in ranges if x.unit == FORCE_UNIT)


def _width(x: Extrema) -> float:
    return x.largest - x.smallest


def _ends(x: Extrema) -> tuple[float, float]:
    return x.smallest, x.largest


class EquivalentsPresenter(Presenter[Equivalents]):
    """How equivalent sets are shown."""

    @override
    def statements(self, answer: Equivalents) -> Iterator[Statement]:
        """The least known stiffness and the sets, then the least known force."""
        region = answer.region
        stiffness = [x for x in region.parameters.values() if x.name.endswith(STIFFNESS)]
        sentences = [
            "Two knees that this measurement cannot distinguish may differ by "
            f"{amount(_width(x), x.unit)} in {parameter_words(x.name)} "
            f"({interval(_ends(x), x.unit)})."
            for x in _widest_first(stiffness)[:1]
        ]
        sentences.append(
            f"Among {region.n_sets} such parameter sets the two farthest apart differ by "
            f"{region.farthest:.3g} typical steps (3 kN, 2 %), and the two closest by "
            f"{region.closest:.3g}. {region.sentence}"
        )
        if answer.power_of_best_test is not None:
            sentences.append(
                "Even the most powerful test at the 5 % level distinguishes one of them from the "
                f"fit in only {100 * answer.power_of_best_test:.0f} of 100 measurements."
            )
        yield self.say(
            " ".join(sentences),
            _table(region.parameters.values(), "Ranges over all equivalent sets"),
            is_answer=True,
        )
        forces = _widest_first(_forces(region.quantities.values()))
        if forces:
            widest, shown = forces[0], forces[:MOST_FORCES]
            several = (
                f" The table lists the {MOST_FORCES} of {len(forces)} forces that differ most."
                * (len(forces) > MOST_FORCES)
            )
            yield self.say(
                f"Among such sets, {parameter_words(widest.name)} lies anywhere "
                f"{between(_ends(widest), widest.unit)}.{several}",
                _table(shown, "Forces that differ most"),
            )
        others = [x for x in region.quantities.values() if x.unit != FORCE_UNIT]
        if others:
            clauses = [
                f"{parameter_words(x.name)} lies anywhere {between(_ends(x), x.unit)}"
                for x in others[:MOST_NAMED]
            ]
            yield self.say(
                f"Among such sets, {listed(clauses)}.", _table(others, "Other predictions")
            )

    @override
    def drawings(self, answer: Equivalents, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.parameter_figures import ranges_figure, sets_figure

        region, names = answer.region, answer.region.parameter_names
        apart = answer.coordinates - answer.coordinates.mean(axis=0)
        bands = {label(x): apart[:, :, j] for j, x in enumerate(COORDINATES)}
        yield Drawing(
            name="sets",
            figure=sets_figure(names, region.sets, region.fit, bands, origin="the mean"),
            caption="Above: parameter sets that this measurement cannot distinguish, one line "
            "each. "
            "Below: how little their laxity differs, trial by trial.",
            description=f"{region.n_sets} equivalent sets of {listed(map(label, names))}, and the "
            "spread of their laxity.",
        )
        forces = _widest_first(_forces(region.quantities.values()))
        if widest := forces[:MOST_DRAWN]:
            shown = [label_without_unit(x.name) for x in widest]
            ends = np.array([(x.smallest, x.largest) for x in widest])
            # Forces of hundreds of N that differ by a few would all be ticks on one axis.
            at_fit = np.array([x.at_fit for x in widest])
            apart = {"equivalent sets": ends - at_fit[:, None]}
            named = [f"{x}, {y:.0f} N" for x, y in zip(shown, at_fit, strict=True)]
            yield Drawing(
                name="force-ranges",
                figure=ranges_figure(named, 0.0 * at_fit, apart, unit="force minus the fit's [N]"),
                caption="Smallest and largest force among these sets, where they differ "
                "most, beside that of the fit (its name and size on the left).",
                description=f"Force ranges; the widest is {shown[0]}, {ends[0, 0]:.0f} to "
                f"{ends[0, 1]:.0f} N.",
            )

    @override
    def band(self, answer: Equivalents) -> Band:
        return "equivalent sets", answer.coordinates, (0.0, 1.0)

    @override
    def ranges(self, answer: Equivalents) -> Iterator[tuple[str, Range]]:
        reach = answer.region.limit / SDS_95**2 if answer.criterion == "noise" else None
        for x in answer.region.extrema:
            yield (
                x.name,
                Range(
                    source=Source.EQUIVALENTS,
                    low=x.smallest,
                    high=x.largest,
                    value=x.at_fit,
                    status="at least so uncertain",
                    reach=reach,
                ),
            )
