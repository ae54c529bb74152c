"""The figures of what a knee carries in every trial, of the results in a folder."""

from collections.abc import Iterator

from identknee.report.page.load_figures import (
    forces_chart,
    knee_loads_figure,
    loads_of,
    strengths_of,
)
from identknee.report.page.results import Findings, Result
from identknee.report.page.viewer import scene_at
from identknee.report.presenter import Drawing, presenter_of
from identknee.subject.plausibility import TENSION
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration

KNEE_LOADS, ALL_FORCES = "knee-loads", "all-forces"
# What they are of.
OF_VERBS = ("fit", "simulate")


def load_drawings(findings: Findings) -> Iterator[tuple[Result, Drawing]]:
    """The knee by trial and a chart of all forces, for the first fit of each table.

    Of simulations where nothing was fitted. None where the knee is not known.
    """
    first_fits = {x.data_digest: x for x in reversed(findings.of("fit"))}
    for result in [*first_fits.values()] or findings.of("simulate"):
        protocol = result.protocol
        if result.knee is None or protocol is None:
            continue
        scene = scene_at(result.answer, result.knee, protocol)
        if scene is None:
            continue
        loads = loads_of(scene, strengths_of(scene) | _own_strengths(result.answer))
        alike = [x.answer for x in findings.results if x.data_digest == result.data_digest]
        ranges = {name: x for own in alike for name, x in presenter_of(own).ranges(own)}
        side = " (a left knee, drawn as a right one)" if scene.knee.side == "left" else ""
        yield (
            result,
            Drawing(
                name=KNEE_LOADS,
                figure=knee_loads_figure(scene, protocol, loads),
                caption="The knee from the front in every trial: ligaments coloured by their share "
                "of the load at which they fail, compartments by contact force. "
                f"Named: the ligament nearest to failure{side}.",
                description="The knee under every load at each flexion angle, coloured by load.",
            ),
        )
        yield (
            result,
            Drawing(
                name=ALL_FORCES,
                figure=forces_chart(
                    protocol.trials,
                    loads,
                    ranges,
                    source="fit" if result.verb == "fit" else "simulated",
                ),
                caption="Every ligament force and contact force in every trial, with 95 % "
                "intervals where known. Line and ground: published load at failure.",
                description=f"Forces of {len(loads.names)} ligaments and both compartments by "
                "trial.",
            ),
        )


def _own_strengths(answer: Answer) -> dict[str, tuple[float, float]]:
    """Strengths that counted as evidence in a fit, by how the names of their ligaments begin."""
    if not isinstance(answer, Calibration) or answer.plausibility is None:
        return {}
    limits = [x.limit for x in answer.plausibility.limits]
    return {
        x.name.removesuffix(FORCE): (x.size, x.spread)
        for x in limits
        if x.form == "strength" and x.name.endswith(FORCE)
    }


FORCE = f".{TENSION}"
