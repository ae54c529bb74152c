"""Figures of what the model gets wrong, and of the trials that would tell."""

from collections.abc import Iterator, Sequence

import numpy as np

from identknee.diagnosis.verdict import Verdict
from identknee.identify.profile.result import Profile
from identknee.model.effects.facts import cause_label
from identknee.report.design_figures import candidates_figure, intervals_figure, steps_figure
from identknee.report.diagnosis_figures import (
    isolability_figure,
    misfit_figure,
    misfit_words,
    parameters_before_after_figure,
    residuals_figure,
)
from identknee.report.diagnosis_files import distances_of
from identknee.report.page.drawing import Drawing
from identknee.report.page.results import Result
from identknee.report.wrench_figure import wrench_figure
from identknee.runs.arrays import Array
from identknee.runs.words import label, listed
from identknee.verbs.design import Design
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.isolability import Isolability


def diagnosis_drawings(result: Result) -> Iterator[Drawing]:
    """Where the model is wrong, what the cause explains, and the parameters with and without."""
    answer = result.answer
    if not isinstance(answer, Diagnosis):
        return
    misfit, trials, residuals = answer.misfit, answer.trials, answer.residuals
    # None of them where the data cannot be tested.
    if misfit is None or trials is None or residuals is None:
        return
    where = misfit_words(misfit.cells, misfit.share)
    yield Drawing(
        name="misfit",
        figure=misfit_figure(misfit.map, where),
        caption="Measured minus predicted, in units of the noise: red where more was measured, "
        "blue where less. Framed cells are hardly due to noise alone.",
        description=f"Map of the misfit by coordinate, flexion and load: {where}.",
    )
    causes = listed(map(cause_label, answer.cause_names))
    before = residuals.before
    changes = {f"what is explained by {causes}": before - residuals.after} if causes else {}
    if (figure := residuals_figure(trials.protocol, before, residuals.sd, changes)) is not None:
        yield Drawing(
            name="residuals",
            figure=figure,
            caption="What the model leaves unexplained along every load curve (dots, with a band "
            "of two standard deviations of the noise)"
            + (", and what the cause explains of it (line)." if causes else "."),
            description="Measured minus predicted laxity along every load curve"
            + (f", with the part that {causes} explains." if causes else "."),
        )
    if result.knee is not None and answer.missing_wrench and not _is_adequate(answer):
        yield Drawing(
            name="missing-wrench",
            figure=wrench_figure(answer, result.knee),
            caption="What else would have to act on the tibia, seen from above: arrows are "
            "forces, arcs are moments. Grey is the range that noise alone could explain.",
            description="Forces and moments that the model lacks, by flexion and load.",
        )
    # Without a cause there is nothing to compare.
    if causes:
        yield Drawing(
            name="before-after",
            figure=parameters_before_after_figure(answer),
            caption="The ligament parameters with their 95 % intervals, without and with the "
            "cause.",
            description=f"Fitted parameters of {listed(answer.parameters_before or ())}, without "
            f"and with {causes}.",
        )


def _is_adequate(answer: Diagnosis) -> bool:
    return answer.verdict is Verdict.ADEQUATE


def isolability_drawings(result: Result) -> Iterator[Drawing]:
    """Which causes the trials of a protocol could tell apart."""
    if isinstance(answer := result.answer, Isolability):
        yield Drawing(
            name="isolability",
            figure=isolability_figure(distances_of(answer)),
            caption="How far the data of each cause (rows) are from what another cause (columns) "
            "could explain in its place. Causes in dark cells cannot be told apart.",
            description=f"Distances between {len(answer.rivals)} causes.",
        )


def design_drawings(result: Result) -> Iterator[Drawing]:
    """What the advised trials would bring, and all that were to choose from."""
    answer = result.answer
    if not isinstance(answer, Design):
        return
    choice = answer.choice
    before, after = (list(x.values()) for x in (choice.before, choice.after))
    ends = {"before": _ends(before), "predicted": choice.predicted[-1], "achieved": _ends(after)}
    names, trials = [label(x) for x in choice.targets], listed(answer.advised)
    yield Drawing(
        name="design-intervals",
        figure=intervals_figure(names, [x.optimum_value for x in before], ends),
        caption="The interval of each target: now, as predicted with the advised trials, and as "
        "found when those trials were simulated.",
        description=f"Intervals of {listed(names)} before and after adding {trials}.",
    )
    widths = np.diff(choice.predicted)[..., 0]
    relative = {x: widths[:, t] / widths[0, t] for t, x in enumerate(names)}
    achieved = dict(zip(names, (np.diff(ends["achieved"])[:, 0] / widths[0]).tolist(), strict=True))
    yield Drawing(
        name="design-steps",
        figure=steps_figure(relative, achieved),
        caption="How much narrower each interval becomes with every trial added.",
        description=f"Relative widths by the number of trials added, down to "
        f"{listed(f'{x:.2f}' for x in achieved.values())}.",
    )
    gains = choice.losses[0] - choice.alone
    yield Drawing(
        name="design-candidates",
        figure=candidates_figure(answer.candidates, gains, choice.chosen, "gain of one such trial"),
        caption="What each possible trial alone would gain. Circles mark the advised trials, with "
        "their order and how often each is to be made.",
        description=f"Gain of {choice.n_candidates} candidate trials; chosen are {trials}.",
    )


def _ends(profiles: Sequence[Profile]) -> Array:
    """Both ends of each interval, shape ``(t, 2)``; NaN where open."""
    return np.array([(x.lower, x.upper) for x in profiles], dtype=np.float64)
