"""Naming itself: which effects join the model, when it ends, and what stands beside the best."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnoses import FRAME, FRAME_DEG, SD, diagnosed, short_trials
from elsewhere import Elsewhere
from scipy.stats import multivariate_normal

from identknee.calibrate.problem import Evaluation
from identknee.diagnosis import fitting
from identknee.diagnosis import verdict as module
from identknee.diagnosis.base_fit import fit_base
from identknee.diagnosis.fitting import (
    Refit,
    expected_distance,
    rivals_of,
    without_causes,
)
from identknee.diagnosis.verdict import (
    FURTHER_GAIN,
    MOST_AMPLITUDES,
    MOST_CAUSES,
    Attribution,
    _Sets,
    attribute,
    is_better,
    refit_top_candidates,
)
from identknee.laxity.table import add_noise
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.subject.reference import reference_knee

SOFT, OFFSET, PRESSED = "rig_compliance_IE", "moment_offset", "compression"


def base_of(**hidden: float) -> Refit:
    """The base fit of 18 trials, with noise, that hide amplitudes of effects."""
    knee, names = reference_knee(), dict.fromkeys(x.partition("__")[0] for x in hidden)
    model = LaxityModel(
        knee=knee, protocol=short_trials(), effects=tuple(effect_named(knee, x) for x in names)
    )
    theta = model.parameters.vector({k.replace("__", "."): v for k, v in hidden.items()})
    laxity = add_noise(model.simulate(theta), sd_mm=SD, sd_deg=SD, seed=5)
    found = fit_base(knee, laxity, starts=[], seed=0)
    assert found is not None
    return without_causes(found)


def attributed(base: Refit, *names: str, is_forced: bool = False) -> Attribution:
    knee = base.fitted.model.knee
    effects = [effect_named(knee, x) for x in names]
    return attribute(base, effects, seed=0, is_forced=is_forced)


# --- on data ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def one() -> Attribution:
    """Data with a turned frame, explained by three effects of which one is there."""
    return attributed(diagnosed(FRAME).base, FRAME, SOFT, PRESSED)


def test_the_cause_that_is_there_is_the_best_explanation(one: Attribution) -> None:
    assert one.best.names == (FRAME,)
    amplitudes = one.best.amplitudes(FRAME)
    sd = np.sqrt(np.diag(one.best.covariance()))[one.best.places(FRAME)]
    # The data have 3 deg about x and none about y.
    assert (np.abs(amplitudes - [FRAME_DEG, 0.0]) < 5.0 * sd).all()
    assert sd.max() < 0.2 * FRAME_DEG
    assert one.base.names == ()
    assert one.base is one.steps[0].at
    assert not one.has_remaining_misfit


def test_the_steps_end_at_the_best_explanation(one: Attribution) -> None:
    first, last = one.steps
    assert first.is_significant
    assert (last.at, last.refits) == (one.best, ())
    assert not last.is_significant
    # What is in the model already is no candidate beside it.
    assert FRAME not in {x.effect.name for x in last.variants}
    evidence = [x.log_evidence for x in first.refits]
    assert evidence == sorted(evidence, reverse=True)
    assert first.refits[0] is one.best


def test_what_the_best_explanation_explains_is_not_left_unexplained(one: Attribution) -> None:
    """Where all effects have joined, the last look is at an earlier fit, and tells of no rest."""
    before = replace(one, steps=one.steps[:1])
    assert before.steps[-1].is_significant
    assert not before.has_remaining_misfit
    assert replace(before, best=one.base).has_remaining_misfit


@pytest.mark.parametrize(("p_value", "first", "further"), [
    (0.06, False, False),
    (0.03, True, False),
    (0.005, True, True),
])  # fmt: skip
def test_a_further_cause_needs_a_rarer_score_than_the_first(
    p_value: float, first: bool, further: bool, one: Attribution
) -> None:
    """5 % beside the base model; 1 % beside a cause, whose own model is only nearly right."""
    step = one.steps[0]
    highest = replace(step.scores.candidates[0], p_value=p_value)
    scored = replace(step, scores=replace(step.scores, candidates=(highest,)))
    assert replace(scored, at=one.base).is_significant is first
    assert replace(scored, at=one.best).is_significant is further


def test_rivals_are_the_other_explanations_each_once_by_their_evidence(one: Attribution) -> None:
    names = [frozenset(x.refit.names) for x in one.rivals]
    assert len(set(names)) == len(names)
    assert frozenset(one.best.names) not in names
    assert names
    deficits = [x.log_evidence_deficit for x in one.rivals]
    assert deficits == sorted(deficits)
    for x in one.rivals:
        assert x.log_evidence_deficit == pytest.approx(one.best.log_evidence - x.refit.log_evidence)
        assert x.distance == pytest.approx(expected_distance(one.best, x.refit))
        assert x.log_evidence_deficit > 0.0


def test_another_fit_of_the_same_causes_is_no_rival(one: Attribution) -> None:
    """It would leave nothing to be named: an explanation never stands against itself."""
    looks = [(x.at, x.scores) for x in one.steps]
    again = replace(one.best)
    assert again is not one.best
    other = one.rivals[0].refit
    found = rivals_of(one.best, [again, other, replace(other)], looks)
    assert [x.refit.names for x in found] == [other.names]


def test_noise_alone_has_no_cause() -> None:
    found = attributed(base_of(), FRAME, SOFT, PRESSED)
    assert found.best is found.base
    assert len(found.steps) == 1
    assert not found.steps[0].is_significant
    assert found.steps[0].refits == ()
    assert found.rivals == ()
    assert not found.has_remaining_misfit


def test_forced_it_tries_a_cause_and_still_demands_that_one_is_better() -> None:
    """Where another test than that of the scores alarmed, all are fitted, none is invented."""
    found = attributed(base_of(), SOFT, PRESSED, is_forced=True)
    assert found.best is found.base
    tried = {x.names for x in found.steps[0].refits}
    assert tried
    assert tried <= {(SOFT,), (PRESSED,)}
    assert {x.refit.names for x in found.rivals} == tried


def test_two_causes_are_found_one_after_the_other() -> None:
    base = base_of(femur_frame__x_deg=4.0, rig_compliance_IE__compliance_deg_per_Nm=0.4)
    found = attributed(base, FRAME, SOFT, PRESSED)
    assert set(found.best.names) == {FRAME, SOFT}
    assert found.best.amplitudes(SOFT)[0] == pytest.approx(0.4, abs=0.15)
    assert [len(x.at.causes) for x in found.steps] == [0, 1, 2]
    # Either alone is beside the pair, and the data speak against it.
    alone = [x for x in found.rivals if len(x.refit.causes) == 1]
    assert alone
    assert all(x.is_excluded for x in alone)


def test_without_the_true_cause_something_is_left_unexplained() -> None:
    """The right answer may be no name: pressing the bones together is no turned frame."""
    base = base_of(femur_frame__x_deg=6.0)
    found = attributed(base, PRESSED, is_forced=True)
    assert FRAME not in found.best.names
    assert found.best.misfit_p_value < 1e-3
    whole = attributed(base, PRESSED, FRAME)
    assert whole.best.names == (FRAME,)
    assert whole.best.misfit_p_value > 1e-3


# --- rules, on refits made by hand --------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Made:
    """As much of a refit as the rules look at."""

    names: tuple[str, ...] = ()
    misfit_chi2: float = 100.0
    log_evidence: float = 0.0
    n_amplitudes: int = 1

    @property
    def causes(self) -> tuple[Any, ...]:
        parameters = SimpleNamespace(n=self.n_amplitudes)
        return tuple(SimpleNamespace(name=x, parameters=parameters) for x in self.names)


N_EFFECTS = 20


def better(new: Made, old: Made) -> bool:
    return is_better(new, old, N_EFFECTS)  # type: ignore[arg-type]


@pytest.mark.parametrize(("fall", "gain", "wins"), [
    (9.1, 2.1, True),
    (8.9, 50.0, False),  # chance alone lets the chi-square fall by so much
    (50.0, 1.9, False),  # the prior makes it no more likely than no cause
])  # fmt: skip
def test_a_first_cause_must_lower_the_misfit_and_gain_evidence(
    fall: float, gain: float, wins: bool
) -> None:
    new = Made(names=("a",), misfit_chi2=100.0 - fall, log_evidence=gain)
    assert better(new, Made()) is wins


@pytest.mark.parametrize(("fall", "wins"), [(16.1, True), (15.9, False)])
def test_a_further_cause_must_lower_it_by_more(fall: float, wins: bool) -> None:
    new = Made(names=("a", "b"), misfit_chi2=100.0 - fall, log_evidence=9.0)
    assert better(new, Made(names=("a",))) is wins


def test_a_larger_set_pays_for_the_number_of_its_size() -> None:
    """Of 20 causes there are 190 pairs: the best of them is ahead by chance."""
    single = Made(names=("a",), misfit_chi2=50.0, log_evidence=10.0)
    pair = Made(names=("a", "b"), misfit_chi2=20.0)
    least = 10.0 + FURTHER_GAIN + np.log(190.0 / 20.0)
    assert better(replace(pair, log_evidence=least + 0.01), single)
    assert not better(replace(pair, log_evidence=least - 0.01), single)
    # Of no cause there is one set only.
    assert not better(replace(pair, log_evidence=FURTHER_GAIN + np.log(190.0) - 0.01), Made())


MadeByNames = dict[tuple[str, ...], Made]


def looked_back(
    monkeypatch: pytest.MonkeyPatch, current: Made, made: MadeByNames, singles: Any = ()
) -> tuple[Made, set[tuple[str, ...]]]:
    """The winner after a look back whose refits are made by hand, and the names of the others."""

    def without(_base: Any, now: Made, name: str, *instead: Made) -> Made:
        left = (x for x in now.names if x != name)
        return made[(*left, *(name for x in instead for name in x.names))]

    monkeypatch.setattr(module, "_without", without)
    monkeypatch.setattr(module, "_alone", lambda _base, _now, single: made[single.names])
    sets = _Sets(Made(), N_EFFECTS)  # type: ignore[arg-type]
    refits: Any = (current, *singles)
    sets.add(refits)
    sets.look_back(singles)
    best: Any = sets.best
    return best, {x.names for x in sets.others}


def test_a_cause_that_another_made_superfluous_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first step's choice may be a stand-in for two that were found after it."""
    current = Made(names=("stand-in", "true"), misfit_chi2=50.0, log_evidence=20.0)
    made: MadeByNames = {
        ("true",): Made(names=("true",), misfit_chi2=60.0, log_evidence=19.0),
        ("stand-in",): Made(names=("stand-in",), misfit_chi2=90.0, log_evidence=5.0),
    }
    best, others = looked_back(monkeypatch, current, made)
    assert best.names == ("true",)
    # A pair that is not worth its causes is no rival of a single cause.
    assert others == {("stand-in",)}


def test_a_cause_that_is_needed_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    current = Made(names=("a", "b"), misfit_chi2=50.0, log_evidence=20.0)
    made: MadeByNames = {
        ("a",): Made(names=("a",), misfit_chi2=67.0, log_evidence=12.0),
        ("b",): Made(names=("b",), misfit_chi2=90.0, log_evidence=5.0),
    }
    best, others = looked_back(monkeypatch, current, made)
    assert best is current
    assert others == {("a",), ("b",)}


def test_a_swap_that_explains_more_takes_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    current = Made(names=("a", "b"), misfit_chi2=80.0, log_evidence=30.0)
    third = Made(names=("c",), misfit_chi2=110.0, log_evidence=1.0)
    poor = [Made(names=(x,), misfit_chi2=120.0, log_evidence=0.0) for x in "abc"]
    pairs = [Made(names=("c", x), misfit_chi2=120.0, log_evidence=0.0) for x in "ab"]
    made: MadeByNames = {
        **{x.names: x for x in (*poor, *pairs)},
        ("b", "c"): Made(names=("b", "c"), misfit_chi2=50.0, log_evidence=40.0),
        ("a", "c"): Made(names=("a", "c"), misfit_chi2=79.0, log_evidence=30.5),
    }
    best, others = looked_back(monkeypatch, current, made, [third])
    assert best.names == ("b", "c")
    assert current.names in others


def test_a_single_cause_refitted_from_the_larger_set_may_win(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its first refit had ended behind a cliff."""
    current = Made(names=("a", "b"), misfit_chi2=50.0, log_evidence=30.0)
    stuck = Made(names=("true",), misfit_chi2=300.0, log_evidence=-90.0)
    bad = Made(names=("a",), misfit_chi2=200.0, log_evidence=-50.0)
    made: MadeByNames = {
        ("a",): bad,
        ("b",): replace(bad, names=("b",)),
        ("true",): replace(stuck, misfit_chi2=45.0, log_evidence=31.0),
        ("a", "true"): replace(bad, names=("a", "true")),
        ("b", "true"): replace(bad, names=("b", "true")),
    }
    best, _ = looked_back(monkeypatch, current, made, [stuck])
    assert best.names == ("true",)


def many_amplitudes(log_evidence: float) -> Made:
    return Made(
        names=("many",),
        misfit_chi2=10.0,
        log_evidence=log_evidence,
        n_amplitudes=MOST_AMPLITUDES + 1,
    )


def test_flexible_effects_are_not_swapped_in(monkeypatch: pytest.MonkeyPatch) -> None:
    current = Made(names=("a", "b"), misfit_chi2=50.0, log_evidence=20.0)
    made: MadeByNames = {
        ("a",): Made(names=("a",), misfit_chi2=90.0, log_evidence=1.0),
        ("b",): Made(names=("b",), misfit_chi2=90.0, log_evidence=1.0),
    }
    best, _ = looked_back(monkeypatch, current, made, [many_amplitudes(90.0)])
    assert best is current


@pytest.mark.parametrize(("evidence", "wins"), [(30.0, True), (19.0, False)])
def test_an_effect_of_many_amplitudes_wins_by_evidence_alone(evidence: float, wins: bool) -> None:
    simple = Made(names=("a",), misfit_chi2=50.0, log_evidence=20.0)
    many: Any = many_amplitudes(evidence)
    sets = _Sets(Made(), N_EFFECTS)  # type: ignore[arg-type]
    both: Any = [simple, many]
    sets.add(both)
    best: Any = sets.best
    assert best is simple
    sets.let_flexible_win(both)
    assert (sets.best is many) is wins
    assert {x.names for x in sets.others} == {("a",) if wins else ("many",)}


def test_no_more_than_three_causes_are_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    """Were every further cause better, it would go on until nothing is left to try."""
    looks = []

    def look(at: Made, effects: Sequence[Any], _seed: int) -> Any:
        looks.append(len(at.causes))
        return Step(at=at, names=tuple(x.name for x in effects))

    @dataclass(frozen=True)
    class Step:
        at: Made
        names: tuple[str, ...]
        refits: tuple[Made, ...] = ()
        is_significant: bool = True
        scores: Any = None

    def refits(step: Any, *_: Any) -> tuple[Made, ...]:
        name, now = step.names[0], step.at
        return (
            Made(
                names=(*now.names, name),
                misfit_chi2=now.misfit_chi2 - 20.0,
                log_evidence=now.log_evidence + 10.0,
            ),
        )

    def poor(_base: Any, now: Made, name: str, *_: Any) -> Made:
        return Made(names=tuple(x for x in now.names if x != name))

    monkeypatch.setattr(module, "score_candidates", look)
    monkeypatch.setattr(module, "refit_top_candidates", refits)
    monkeypatch.setattr(module, "_without", poor)
    monkeypatch.setattr(module, "_alone", lambda _base, _now, single: single)
    monkeypatch.setattr(module, "rivals_of", lambda *_: ())
    effects: Any = [SimpleNamespace(name=x) for x in "abcde"]
    found = attribute(Made(), effects, seed=0)  # type: ignore[arg-type]
    assert found.best.names == ("a", "b", "c")
    assert looks == [0, 1, 2, 3]
    assert MOST_CAUSES == 3


def test_only_what_scores_is_refitted(one: Attribution) -> None:
    """A score of one is what noise gives every other effect."""
    step = one.steps[0]
    scored = {x.name for x in step.scores.candidates if x.score > 1.0}
    assert {x.names[0] for x in step.refits} <= scored
    nothing = replace(
        step, scores=replace(step.scores, candidates=step.scores.candidates[-1:]), refits=()
    )
    low = replace(nothing.scores.candidates[0], score=0.5)
    quiet = replace(nothing, scores=replace(nothing.scores, candidates=(low,)))
    assert refit_top_candidates(quiet, one.base) == ()


@pytest.mark.slow
def test_refits_of_another_process_are_the_same(one: Attribution) -> None:
    step, executor = one.steps[0], Elsewhere()
    few = replace(step, scores=replace(step.scores, candidates=step.scores.candidates[:2]))
    here, there = (refit_top_candidates(few, one.base, *x) for x in ((), (executor,)))
    # Each is begun, and then taken to its end.
    assert executor.n_done == 2 * len(here) == 4
    for x, y in zip(here, there, strict=True):
        assert x.names == y.names
        np.testing.assert_array_equal(x.fitted.theta, y.fitted.theta)
        assert x.log_evidence == y.log_evidence


def test_evidence_is_computed_where_it_is_asked_for_and_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Evaluation] = []

    def counted(evaluation: Evaluation, *_: Any) -> float:
        asked.append(evaluation)
        return -3.0

    monkeypatch.setattr(fitting, "log_evidence", counted)
    evaluation: Any = SimpleNamespace(is_finite=True)
    fitted: Any = SimpleNamespace(
        evaluation=evaluation,
        model=SimpleNamespace(parameters=None),
        constrained=SimpleNamespace(is_held=None),
    )
    tried = Refit(causes=(), fitted=fitted, smooth=np.zeros((0, 0)), noise_degrees=1e9)
    assert not asked
    assert (tried.log_evidence, tried.log_evidence) == (-3.0, -3.0)
    assert asked == [evaluation]


def evidence_of(columns: Array, data: Array, *, lower: float) -> float:
    """`Refit.log_evidence` of a linear model with unit noise and priors of sd 2 around 0."""
    n = columns.shape[1]
    jacobian = np.vstack([columns, np.eye(n) / 2.0])
    theta = np.linalg.solve(jacobian.T @ jacobian, columns.T @ data)
    residuals = np.r_[columns @ theta - data, theta / 2.0]
    evaluation = Evaluation(theta=theta, residuals=residuals, jacobian=jacobian)
    parameters = Parameters(
        names=tuple(f"x{i}.amplitude_mm" for i in range(n)),
        center=np.zeros(n),
        lower=np.full(n, lower),
        upper=np.full(n, 50.0),
        prior_sd=np.full(n, 2.0),
        is_log=np.zeros(n, bool),
    )
    fitted: Any = SimpleNamespace(
        evaluation=evaluation,
        model=SimpleNamespace(parameters=parameters),
        constrained=SimpleNamespace(is_held=np.zeros(n, bool)),
    )
    return Refit(causes=(), fitted=fitted, smooth=np.zeros((0, 0)), noise_degrees=1e9).log_evidence


def test_evidence_is_the_probability_of_the_data_up_to_a_constant() -> None:
    """Of a linear model in closed form: a normal density with the spread of prior and noise."""
    generator = np.random.default_rng(2)
    columns = generator.normal(size=(30, 4))
    data = columns @ [3.0, 4.0, 2.0, 3.0] + generator.normal(size=30)

    def exact(n: int) -> float:
        covariance = np.eye(30) + 4.0 * columns[:, :n] @ columns[:, :n].T
        return float(multivariate_normal(cov=covariance).logpdf(data))

    constant = evidence_of(columns[:, :1], data, lower=-50.0) - exact(1)
    for n in (2, 3, 4):
        found = evidence_of(columns[:, :n], data, lower=-50.0)
        assert found - exact(n) == pytest.approx(constant)
    # Amplitudes of one sign, all well inside: a half-normal prior has twice the density.
    signed = evidence_of(columns, data, lower=0.0)
    assert signed == pytest.approx(evidence_of(columns, data, lower=-50.0) + 4.0 * np.log(2.0))
