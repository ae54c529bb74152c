"""Figures, tables and sentences of a diagnosis."""

from dataclasses import replace

import numpy as np
import pytest
from diagnoses import FRAME, answered, diagnosed
from slow_cases import some_slow

from identknee.diagnosis.fitting import RivalState, refit
from identknee.diagnosis.investigation import Investigation
from identknee.diagnosis.isolability import Distances
from identknee.diagnosis.misfit import LEVEL
from identknee.diagnosis.missing_line import LineFinding
from identknee.diagnosis.verdict import Conclusion, Verdict
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.model.effects.facts import MISSING_LINE
from identknee.model.effects.structures import structure_at
from identknee.report.diagnosis_figures import (
    added_variable_figure,
    diagnosis_figures,
    isolability_figure,
    largest_pulls,
    misfit_figure,
    misfit_words,
    parameters_before_after_figure,
    residual_curves_figure,
    residuals_figure,
    wrench_figure,
)
from identknee.report.figures import MEASURED, png
from identknee.report.presenter import statements_of
from identknee.runs.schema import summary_of
from identknee.subject.insertion_sites import name_of_place
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnosis import diagnosis_of, untestable
from identknee.verbs.files import groups_of

EFFECTS = (None, FRAME)


def _unexplained(conclusion: Conclusion) -> Conclusion:
    return replace(conclusion, verdict=Verdict.UNEXPLAINED, group=())


@pytest.mark.parametrize("effect", some_slow(EFFECTS, ["femur_frame"]))
def test_every_figure_can_be_drawn(effect: str | None) -> None:
    for figure in diagnosis_figures(answered(effect), reference_knee()).values():
        assert png(figure).startswith(b"\x89PNG")


def test_a_gain_counts_from_two_standard_errors_on() -> None:
    answer = answered(FRAME)
    gain = answer.gain
    assert gain is not None
    for errors, said in (
        (2.1, "With the cause, the error on held-out trials"),
        (1.9, "The cause does not clearly improve"),
    ):
        unsure = replace(answer, gain=replace(gain, elpd_se=gain.elpd_difference / errors))
        sentences = " ".join(x.sentence for x in statements_of(unsure))
        assert said in sentences
        assert ("With one flexion angle left out at a time" in sentences) is (errors < 2.0)


def test_the_map_frames_what_is_significant_and_nothing_else() -> None:
    for effect in EFFECTS:
        misfit = answered(effect).misfit
        assert misfit is not None
        cells = misfit.map
        axes = misfit_figure(cells, misfit_words(misfit.cells, misfit.share)).axes[0]
        assert len(axes.texts) == len(cells) + len({x.flexion_deg for x in cells})
        frames = [x for x in axes.lines if np.size(x.get_xdata()) == 5]
        assert len(frames) == sum(x.p_value <= 0.05 for x in cells)


def test_an_empty_map_is_drawn_too() -> None:
    assert png(misfit_figure((), misfit_words((), 0.0))).startswith(b"\x89PNG")


def test_the_cause_goes_through_the_residuals_of_its_curves() -> None:
    """The line of the right cause leaves less than the base model does."""
    figure = residual_curves_figure(answered(FRAME))
    assert figure is not None
    panels = [x for x in figure.axes if x.lines]
    assert len(panels) == len(COORDINATES) * 4
    left = before = 0.0
    for axes in panels:
        dots = next(x for x in axes.lines if x.get_marker() == "o")
        x, measured = (np.asarray(values) for values in dots.get_data())
        # First comes the line of zero, then the candidates, the best one first.
        cause = axes.lines[1]
        np.testing.assert_array_equal(np.asarray(cause.get_xdata()), x)
        before += float(np.sum(measured**2))
        left += float(np.sum((measured - np.asarray(cause.get_ydata())) ** 2))
    assert left < 0.5 * before


def test_the_points_of_the_right_cause_follow_the_line() -> None:
    added = answered(FRAME).added_variable
    assert added is not None
    axes = added_variable_figure(added).axes[0]
    dots = [x for x in axes.lines if x.get_linestyle() == "None"]
    x, y = (np.concatenate([np.asarray(d.get_data()[k]) for d in dots]) for k in range(2))
    # Its amplitude is that of least squares, shrunk a little by its prior.
    assert x @ y / (x @ x) == pytest.approx(1.0, abs=0.05)


def test_truth_is_drawn_where_it_is_known() -> None:
    figure = parameters_before_after_figure(answered(FRAME), {"ACL.stiffness_kN": 10.0})
    first, second, *_ = figure.axes
    assert len(first.lines) == len(second.lines) + 1


def test_distances_below_the_limit_are_written() -> None:
    values = np.array([[0.0, 2.5, 9.0], [3.0, 0.0, np.inf], [9.0, 9.0, 0.0]])
    names = ("a", "b", "c")
    axes = isolability_figure(Distances(effects=names, rivals=names, values=values)).axes[0]
    assert sorted(x.get_text() for x in axes.texts) == ["2.5", "3.0"]


def test_what_cannot_be_tested_has_the_same_keys() -> None:
    nothing = summary_of(untestable("why"))
    assert set(nothing) == set(summary_of(answered(None)))
    assert nothing["reasons"] == ["why"]


def test_rivals_that_are_open_come_with_their_own_numbers() -> None:
    for rival in answered(FRAME).rivals:
        assert bool(rival.amplitudes) == (rival.state is RivalState.OPEN)
        assert (rival.parameters is None) == (rival.state is not RivalState.OPEN)
        assert rival.is_excluded == (rival.state is RivalState.EXCLUDED)


def test_an_unexplained_misfit_changes_no_parameter() -> None:
    found = diagnosed(FRAME)
    unexplained = replace(found, conclusion=_unexplained(found.conclusion))
    assert unexplained.explanation is found.base
    answer = diagnosis_of(unexplained)
    assert answer.causes == ()
    assert answer.parameters_after == answer.parameters_before
    said = " ".join(x.sentence for x in statements_of(answer))
    assert "added cause" in said


def test_lines_of_a_left_knee_are_where_it_was_scanned(reference: Knee) -> None:
    found = _with_line(diagnosed(FRAME), reference)
    assert found.line is not None
    fitted = found.line.refit.fitted
    model = replace(fitted.model, knee=replace(fitted.model.knee, side="left"))
    left = replace(found.line.refit, fitted=replace(fitted, model=model))
    mirrored = replace(found, line=replace(found.line, refit=left))
    one, other = (diagnosis_of(x).line for x in (found, mirrored))
    assert one is not None
    assert other is not None
    for end in ("femur", "tibia"):
        np.testing.assert_array_equal(
            np.multiply(getattr(one, end), [1.0, 1.0, -1.0]), getattr(other, end)
        )
    np.testing.assert_array_equal(other.in_common_frame(model.knee), one.in_common_frame(reference))


def _with_line(found: Investigation, knee: Knee) -> Investigation:
    """As if the data were unexplained and a line along the MCL had been found."""
    ends = knee.ligament("MCL").femur, knee.ligament("MCL").tibia
    cause = structure_at(knee, MISSING_LINE, [ends], stiffness_sd=1.0, sites_vary=False)
    line = LineFinding(
        refit=refit(found.base, [cause], [np.r_[found.base.fitted.theta, 0.1, 2.0]]),
        femur=ends[0],
        tibia=ends[1],
        covariance=np.eye(6),
        place=name_of_place(knee, *ends),
        trial=found.laxity.protocol.trials[0],
        force=50.0,
        force_interval=np.array([30.0, 70.0]),
        score=9.0,
        p_value=0.001,
        misfit_before=found.base.fitted.misfit,
        n_simulations=10,
        seed=0,
    )
    return replace(found, conclusion=_unexplained(found.conclusion), line=line)


def test_a_line_of_force_is_a_cause_that_the_library_lacks(reference: Knee) -> None:
    answer = diagnosis_of(_with_line(diagnosed(None), reference))
    assert answer.line is not None
    assert answer.line.side == "medial"
    assert answer.cause_names == (MISSING_LINE,)
    assert answer.causes[0].unit == "kN"
    for figure in diagnosis_figures(answer, reference).values():
        assert png(figure).startswith(b"\x89PNG")
    assert [x.label for x in answer.explanations][:2] == ["none", MISSING_LINE]
    first, *_ = statements_of(answer)
    assert answer.line.sentence in first.sentence
    (effect,) = [x for x in answer.extended_knee(reference).effects if x.name == MISSING_LINE]
    np.testing.assert_array_equal(effect.lines[0][0], reference.ligament("MCL").femur)


def test_a_line_that_does_not_explain_the_data_is_no_cause(reference: Knee) -> None:
    """A turned frame is no force along a line."""
    answer = diagnosis_of(_with_line(diagnosed(FRAME), reference))
    assert answer.line is not None
    assert not answer.line.is_line
    assert answer.causes == ()


def test_every_array_stands_over_the_trials_and_effects_it_is_of() -> None:
    found, answer = diagnosed(FRAME), answered(FRAME)
    groups = groups_of(answer)
    assert groups["residuals"]["after"].shape == found.laxity.coordinates.shape
    after = groups["residuals"]["after"].to_numpy()
    assert np.nanstd(after) < np.nanstd(groups["residuals"]["before"].to_numpy())
    assert groups["scores"]["effect"].to_numpy().tolist() == [x.name for x in found.exclusions]
    assert groups["misfit"]["score"].shape == (len(found.localisation.cells),)
    assert groups["refits"]["residuals"].dims == ("explanation", "trial", "coordinate")


def test_the_extended_knee_is_that_of_the_fit(reference: Knee) -> None:
    made = answered(FRAME).extended_knee(reference)
    expected = diagnosed(FRAME).extended_knee
    assert [(x.name, x.values) for x in made.effects] == [
        (x.name, x.values) for x in expected.effects
    ]


def test_residuals_are_drawn_by_load_where_there_are_no_load_curves() -> None:
    angles = np.array([10.0, 20.0, 30.0, 40.0])
    loads = np.zeros((4, 5))
    loads[:, 0] = [-4.0, 0.0, 2.0, 4.0]
    protocol = Protocol(name="x", trials=tuple("abcd"), flexion_deg=angles, loads=loads)
    left, sd = np.arange(20.0).reshape(4, 5), np.ones((4, 5))
    figure = residuals_figure(protocol, left, sd, {"with a cause": left - 1.0})
    assert figure is not None
    dots = [x for axes in figure.axes for x in axes.lines if x.get_color() == MEASURED]
    drawn = np.concatenate([np.asarray(x.get_ydata()) for x in dots if x.get_marker() != "x"])
    assert set(drawn.tolist()) == set(left[[0, 2, 3]].ravel().tolist())
    assert [x.get_text()[-8:] for x in figure.axes[0].texts] == [", 1.0 mm"]
    same = replace(protocol, flexion_deg=np.full(4, 30.0))
    along = residuals_figure(same, left, sd, {})
    assert along is not None
    assert "N·m" in along.axes[-1].get_xlabel()
    assert residuals_figure(same, np.full((4, 5), np.nan), sd, {}) is None


def test_the_largest_missing_forces_are_drawn_and_all_are_in_a_table() -> None:
    answer = answered(FRAME)
    pulls = answer.missing_wrench
    assert len(pulls) > 6
    figure = wrench_figure(answer, reference_knee())
    assert figure is not None
    kept = largest_pulls(pulls)
    assert [x.get_title() for x in figure.axes] == [
        f"{x.flexion_deg:g} deg, {x.direction}" for x in kept
    ]
    sizes = [np.hypot(x.anterior_force_N, x.lateral_force_N) for x in pulls if x.p_value <= LEVEL]
    assert max(sizes) in [np.hypot(x.anterior_force_N, x.lateral_force_N) for x in kept]
    tables = [x for y in statements_of(answer) for x in y.tables if "Missing force" in x.title]
    assert [len(x.rows) for x in tables] == [len(pulls)]
