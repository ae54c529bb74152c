"""Laxity of results as curves: measured, simulated, and the band of what fits as well."""

from collections.abc import Iterator

from identknee.report.laxity_figures import (
    LaxityCurves,
    all_coordinates_figure,
    along_load_figure,
    by_flexion_figure,
)
from identknee.report.page.results import Findings, Result
from identknee.report.presenter import Drawing, of_type, presenter_of
from identknee.runs.words import listed
from identknee.verbs.diagnosis import Diagnosis


def laxity_drawings(findings: Findings) -> Iterator[tuple[Result, Drawing]]:
    """Laxity curves of the results that compare a model with data, or else of simulations."""
    fits = findings.of("fit")
    # Without causes the model of a diagnosis is that of the fits.
    diagnoses = [
        x
        for x in findings.of("diagnose")
        if not fits or any(y.causes for y in of_type([x.answer], Diagnosis))
    ]
    first_fits = {x.data_digest: x for x in reversed(fits)}
    compared = [*first_fits.values(), *diagnoses] or findings.of("demo", "simulate")
    for result in compared:
        beside = [x.answer for x in findings.results if x.data_digest == result.data_digest]
        curves = presenter_of(result.answer).curves(result.answer, beside)
        if curves is None:
            continue
        told = listed([*curves.simulated, *(["data"] if curves.measured is not None else [])])
        if (figure := along_load_figure(curves)) is not None:
            parts = [f"lines: {listed(curves.simulated)}"]
            if curves.measured is not None:
                bars = " with two standard deviations" if curves.sd is not None else ""
                parts.insert(0, f"dots: measured{bars}")
            if curves.band is not None:
                parts.append(f"band: {curves.band[0]}")
            yield (
                result,
                Drawing(
                    name="laxity",
                    figure=figure,
                    caption=(f"Displacement along each load; {'; '.join(parts)}."),
                    description=f"Laxity along every load at each flexion angle: {told}.",
                ),
            )
        else:
            yield (
                result,
                Drawing(
                    name="laxity",
                    figure=by_flexion_figure(curves),
                    caption=_by_flexion_caption(curves),
                    description=f"All five coordinates of every trial against flexion: {told}.",
                ),
            )
        if (whole := all_coordinates_figure(curves)) is not None:
            yield (
                result,
                Drawing(
                    name="laxity-all",
                    figure=whole,
                    caption="All five coordinates along every load, also those it does not act "
                    "on directly.",
                    description=f"Five coordinates along every load: {told}.",
                ),
            )


def _by_flexion_caption(curves: LaxityCurves) -> str:
    drawn = listed(curves.simulated)
    if curves.measured is None:
        return f"Where the tibia lies in every trial; coloured: {drawn}."
    return (
        f"Where the tibia lies in every trial; black: measured, coloured: {drawn}. A line joins "
        "both of one trial: the longer, the worse they agree."
    )
