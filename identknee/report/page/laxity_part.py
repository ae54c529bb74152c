"""Laxity of results as curves: measured, simulated, and the band of what fits as well."""

from collections.abc import Callable, Iterator

import numpy as np

from identknee.laxity.zeros import ABSOLUTE, from_zero
from identknee.model.effects.facts import cause_label
from identknee.report.laxity_figures import (
    LaxityCurves,
    all_coordinates_figure,
    along_load_figure,
    by_flexion_figure,
)
from identknee.report.page.drawing import Drawing
from identknee.report.page.results import Findings, Result
from identknee.runs.arrays import Array
from identknee.runs.words import listed
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.equivalents import Equivalents
from identknee.verbs.fit import Calibration
from identknee.verbs.sample import Sample
from identknee.verbs.simulate import SimulatedLaxity, Simulation

BAND_ENDS = (0.025, 0.975)
MOST_LINES = 4


def laxity_drawings(findings: Findings) -> Iterator[tuple[Result, Drawing]]:
    """Laxity curves of the results that compare a model with data, or else of simulations."""
    fits = findings.of("fit")
    # Without causes the model of a diagnosis is that of the fits.
    diagnoses = [x for x in findings.of("diagnose") if not fits or _has_causes(x.answer)]
    first_fits = {x.data_digest: x for x in reversed(fits)}
    compared = [*first_fits.values(), *diagnoses] or findings.of("demo", "simulate")
    for result in compared:
        curves = _curves(result, findings)
        if curves is None:
            continue
        told = listed([*curves.simulated, *(["data"] if curves.measured is not None else [])])
        if (figure := along_load_figure(curves)) is not None:
            yield (
                result,
                Drawing(
                    name="laxity",
                    figure=figure,
                    caption=_caption(curves),
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


def _has_causes(answer: Answer) -> bool:
    return isinstance(answer, Diagnosis) and bool(answer.causes)


def _curves(result: Result, findings: Findings) -> LaxityCurves | None:
    if isinstance(result.answer, SimulatedLaxity):
        return _of_answer(result, result.answer, findings)
    if isinstance(result.answer, Diagnosis):
        return _diagnosed(result.answer)
    return None


def _of_answer(result: Result, answer: SimulatedLaxity, findings: Findings) -> LaxityCurves:
    """Curves of a model beside the data that it was fitted to, or alone."""
    data = answer.data if isinstance(answer, Calibration) else None
    if data is None and isinstance(answer, Simulation):
        data = answer.noisy
    zero = ABSOLUTE if data is None else data.zero

    def as_measured(values: Array) -> Array:
        return from_zero(values, answer.protocol, zero)

    simulated = {"simulated": as_measured(answer.coordinates)}
    if isinstance(answer, Calibration):
        fits = list(_fits_of(result.data_digest, answer, findings))[:MOST_LINES]
        simulated = {
            "fit" if len(fits) == 1 else f"fit from {x.start}": as_measured(x.coordinates)
            for x in fits
        }
    return LaxityCurves(
        protocol=answer.protocol,
        simulated=simulated,
        measured=None if data is None else data.coordinates,
        sd=None if data is None else data.sd,
        band=_band(result, findings, as_measured) if isinstance(answer, Calibration) else None,
    )


def _fits_of(data: str, first: Calibration, findings: Findings) -> Iterator[Calibration]:
    """All fits to one table of the same trials."""
    for result in findings.of("fit"):
        answer = result.answer
        if not isinstance(answer, Calibration) or result.data_digest != data:
            continue
        if answer.protocol.trials == first.protocol.trials:
            yield answer


def _diagnosed(answer: Diagnosis) -> LaxityCurves | None:
    """The laxity of the model without and with the causes; None where nothing was tested."""
    trials, residuals = answer.trials, answer.residuals
    if trials is None or residuals is None:
        return None
    simulated = {"model": trials.coordinates - residuals.before}
    if answer.causes:
        with_causes = f"with {listed(map(cause_label, answer.cause_names))}"
        simulated[with_causes] = trials.coordinates - residuals.after
    return LaxityCurves(
        protocol=trials.protocol,
        simulated=simulated,
        measured=trials.coordinates,
        sd=trials.sd,
        band=None,
    )


def _band(
    result: Result, findings: Findings, as_measured: Callable[[Array], Array]
) -> tuple[str, Array] | None:
    """Predictions of the posterior, or of equivalent sets, from the same data."""
    data = result.record["inputs"].get("data")
    for other in findings.of("sample", "equivalents"):
        if other.record["inputs"].get("data") != data:
            continue
        if isinstance(other.answer, Equivalents):
            drawn = np.array([as_measured(x) for x in other.answer.coordinates])
            return "equivalent sets", np.quantile(drawn, (0.0, 1.0), axis=0)
        if isinstance(other.answer, Sample) and other.answer.predictive is not None:
            values = other.answer.predictive.coordinates
            drawn = np.array([as_measured(x) for x in values.reshape(-1, *values.shape[-2:])])
            return "95 % of the posterior", np.quantile(drawn, BAND_ENDS, axis=0)
    return None


def _caption(curves: LaxityCurves) -> str:
    parts = [f"lines: {listed(curves.simulated)}"]
    if curves.measured is not None:
        bars = " with two standard deviations" if curves.sd is not None else ""
        parts.insert(0, f"dots: measured{bars}")
    if curves.band is not None:
        parts.append(f"band: {curves.band[0]}")
    return f"How far the knee moves along each load; {'; '.join(parts)}."


def _by_flexion_caption(curves: LaxityCurves) -> str:
    drawn = listed(curves.simulated)
    if curves.measured is None:
        return f"Where the tibia lies in every trial; coloured: {drawn}."
    return (
        f"Where the tibia lies in every trial; black: measured, coloured: {drawn}. A line joins "
        "both of one trial: the longer, the worse they agree."
    )
