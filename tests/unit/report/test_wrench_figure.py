"""What a model lacks, as arrows on the plateau."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from diagnoses import FRAME, answered, diagnosed
from figure_checks import drawn
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Ellipse, FancyArrowPatch

from identknee.diagnosis.misfit import LEVEL
from identknee.diagnosis.verdict import Verdict
from identknee.model.missing_wrench import missing_wrench
from identknee.report.diagnosis_figures import SHOWN, largest_pulls, wrench_figure
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import load


def drawn_wrench(answer: Diagnosis) -> Figure:
    figure = wrench_figure(answer, reference_knee())
    assert figure is not None
    return figure


def test_every_panel_has_a_force_and_its_ellipse() -> None:
    pulls = largest_pulls(answered(FRAME).missing_wrench)
    figure = drawn_wrench(answered(FRAME))
    panels = [x for x in figure.axes if x.patches]
    assert len(panels) == len(pulls)
    kinds = [[type(x) for x in panel.patches] for panel in panels]
    assert sum(x.count(Ellipse) for x in kinds) == len(pulls)
    for types in kinds:
        # An arc has a head of its own.
        assert types.count(FancyArrowPatch) == 1 + types.count(Arc)


def test_names_stand_clear_of_the_arrows() -> None:
    answer = load(Path(__file__).parents[2] / "fuzz" / "results" / "diagnose")
    assert isinstance(answer, Diagnosis)
    figure = drawn_wrench(answer)
    renderer = drawn(figure)
    (panel,) = [x for x in figure.axes if any(y.get_text() == "LCL" for y in x.texts)]
    arrows = [x.get_window_extent(renderer) for x in panel.patches if type(x) is FancyArrowPatch]
    names = [x.name for x in reference_knee().ligaments]
    for text in panel.texts:
        if text.get_text() in names:
            assert not any(text.get_window_extent(renderer).overlaps(x) for x in arrows)


def test_what_may_be_noise_is_grey() -> None:
    for effect in (None, FRAME):
        answer = answered(effect)
        panels = drawn_wrench(answer).axes
        ellipses = [x for axes in panels for x in axes.patches if type(x) is Ellipse]
        bright = [x for x in ellipses if np.allclose(x.get_facecolor()[:3], to_rgb(SHOWN))]
        assert len(bright) == sum(x.p_value <= LEVEL for x in largest_pulls(answer.missing_wrench))


def test_it_is_what_is_missing_beside_the_ligaments_of_the_explanation() -> None:
    found = diagnosed(FRAME)
    base = found.base.fitted
    n = base.model.parameters.n
    theta = found.explanation.fitted.theta[:n]
    assert not np.array_equal(theta, base.theta)
    errors = found.noise.sd, found.noise.correlation
    expected = missing_wrench(base.compared, theta, *errors)
    np.testing.assert_array_equal(found.missing_wrench.wrench, expected.wrench)
    nameless = replace(
        found, conclusion=replace(found.conclusion, verdict=Verdict.UNEXPLAINED, group=())
    )
    alone = missing_wrench(base.compared, base.theta, *errors)
    np.testing.assert_array_equal(nameless.missing_wrench.wrench, alone.wrench)
