"""Each branch of naming on explanations made by hand: rivals, the verdict, and what is refitted."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typing_extensions import override

from identknee.diagnosis import verdict as naming
from identknee.diagnosis.fitting import Rival, RivalState, could_matter
from identknee.diagnosis.verdict import (
    MOST_AMPLITUDES,
    MOST_REFITS,
    NOISE_DEPENDENT,
    SEVERAL,
    UNTESTED,
    Conclusion,
    Verdict,
    _high_scoring,
    attribute,
    conclude,
)
from identknee.model.effects.loads import (
    axis_misalignment,
    compression,
    moment_gain,
    moment_offset,
    shank_gravity,
)
from identknee.runs.record import Outcome

ALARM = 1e-6


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """As much of a refit as naming looks at."""

    names: tuple[str, ...] = ()
    misfit_p_value: float = 0.5
    pattern_p_value: float = 0.5
    noise_degrees: float = 60.0
    log_evidence: float = 0.0
    misfit_chi2: float = 100.0
    outcome: Outcome = Outcome.MINIMUM
    is_finite: bool = True
    predicted_reduction: float = 0.0
    n_amplitudes: int = 1
    ends: tuple[str, ...] = ()
    alarms: dict[float, float] = field(default_factory=dict)

    @property
    def causes(self) -> tuple[Any, ...]:
        parameters = SimpleNamespace(n=self.n_amplitudes)
        return tuple(SimpleNamespace(name=x, parameters=parameters) for x in self.names)

    @property
    def fitted(self) -> Any:
        evaluation = SimpleNamespace(is_finite=self.is_finite)
        return SimpleNamespace(evaluation=evaluation, outcome=self.outcome)

    def is_at_range_end(self, name: str) -> bool:
        return name in self.ends

    def alarm_p_value(self, _score: float, factor: float = 1.0) -> float:
        return self.alarms.get(factor, ALARM)


@dataclass(frozen=True, kw_only=True)
class Loads(Explanation):
    """One whose causes are effects of the library."""

    made: tuple[Any, ...] = ()

    @property
    @override
    def causes(self) -> tuple[Any, ...]:
        return self.made


def scored(name: str, score: float, p_value: float = 0.001) -> Any:
    return SimpleNamespace(name=name, score=score, p_value=p_value)


def rival(deficit: float, distance: float = 9.0, score: float = 9.0, **made: Any) -> Rival:
    refit: Any = Explanation(names=("other",), **made)
    return Rival(
        refit=refit,
        log_evidence_deficit=deficit,
        distance=distance,
        score=scored("other", score),
        highest=10.0,
    )


# --- rivals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("deficit", "distance", "state"), [
    (5.9, 99.0, RivalState.OPEN),  # too near in evidence, however far apart the data could tell
    (6.1, 4.9, RivalState.OPEN),  # behind, but these data could not tell both apart
    (6.1, 5.1, RivalState.EXCLUDED),
    (9.9, 4.9, RivalState.OPEN),
    (10.1, 0.0, RivalState.EXCLUDED),  # so far behind that it does not matter
])  # fmt: skip
def test_a_rival_is_excluded_by_evidence_and_distance(
    deficit: float, distance: float, state: RivalState
) -> None:
    assert rival(deficit, distance).state is state


@pytest.mark.parametrize(("made", "deficit", "state"), [
    ({"is_finite": False}, 50.0, RivalState.NOT_TESTED),
    ({"outcome": Outcome.CLIFF, "predicted_reduction": 81.0}, 50.0, RivalState.NOT_TESTED),
    ({"outcome": Outcome.CLIFF, "predicted_reduction": 79.0}, 50.0, RivalState.EXCLUDED),
    ({"outcome": Outcome.MINIMUM, "predicted_reduction": 81.0}, 50.0, RivalState.EXCLUDED),
    ({"outcome": Outcome.CLIFF, "predicted_reduction": 1.0}, 3.0, RivalState.OPEN),
])  # fmt: skip
def test_a_fit_that_was_stopped_counts_as_good_as_it_promises_to_become(
    made: dict[str, Any], deficit: float, state: RivalState
) -> None:
    one = rival(deficit, **made)
    assert one.state is state
    assert bool(one.reason) == (state is RivalState.NOT_TESTED)


@pytest.mark.parametrize(("score", "p_value", "matters"), [
    (5.0, 0.05, True),
    (4.9, 0.001, False),  # half of the highest score is the least of a true cause
    (9.0, 0.051, False),  # chance explains it
])  # fmt: skip
def test_only_what_scores_high_could_matter(score: float, p_value: float, matters: bool) -> None:
    assert could_matter(scored("other", score, p_value), 10.0) is matters


# --- the verdict --------------------------------------------------------------------------------


def concluded(
    best: Explanation,
    rivals: tuple[Rival, ...] = (),
    *,
    p_value: float = 1e-4,
    base: Explanation | None = None,
    rest: str = "",
) -> Conclusion:
    """The verdict where these stand beside a base model that does not fit."""
    first: Any = SimpleNamespace(
        at=base or Explanation(misfit_p_value=0.0),
        scores=SimpleNamespace(p_value=ALARM, candidates=()),
        is_significant=True,
    )
    last: Any = SimpleNamespace(
        at=best, scores=SimpleNamespace(candidates=[scored(rest, 8.0)]), is_significant=bool(rest)
    )
    made: Any = best
    return conclude(naming.Attribution(steps=(first, last), best=made, rivals=rivals), p_value)


ONE = Explanation(names=("cause",))


def test_noise_alone_is_adequate() -> None:
    found = concluded(ONE, p_value=0.06)
    assert (found.verdict, found.group, found.best.names) == (Verdict.ADEQUATE, (), ())
    assert concluded(ONE, p_value=0.05).verdict is Verdict.NAMED


def test_one_cause_that_fits_alone_is_named() -> None:
    found = concluded(ONE, (rival(20.0),))
    assert (found.verdict, found.group) == (Verdict.NAMED, ("cause",))
    pair = concluded(Explanation(names=("a", "b")))
    assert (pair.verdict, pair.group) == (Verdict.NAMED, ("a", "b"))


def test_more_than_two_causes_stand_in_for_something_else() -> None:
    found = concluded(Explanation(names=("a", "b", "c")))
    assert (found.verdict, found.group) == (Verdict.UNEXPLAINED, ())
    assert "missing wrench" in found.reasons[1]


def test_open_rivals_leave_it_ambiguous() -> None:
    found = concluded(ONE, (rival(1.0), rival(20.0)))
    assert (found.verdict, found.group) == (Verdict.AMBIGUOUS, ("cause", "other"))
    assert found.sentence == SEVERAL


@pytest.mark.parametrize(("best", "rest", "doubt"), [
    (replace(ONE, misfit_p_value=0.009), "", "its residuals exceed the noise"),
    (replace(ONE, pattern_p_value=0.049), "", "what it leaves has a pattern"),
    (ONE, "third", "significant misfit remains"),
])  # fmt: skip
def test_a_doubt_leaves_it_ambiguous(best: Explanation, rest: str, doubt: str) -> None:
    found = concluded(best, rest=rest)
    assert (found.verdict, found.group) == (Verdict.AMBIGUOUS, ("cause",))
    assert found.sentence.endswith(f"with a doubt: {doubt}.")
    clear = replace(best, misfit_p_value=0.011, pattern_p_value=0.051)
    assert concluded(clear).verdict is Verdict.NAMED


@pytest.mark.parametrize(("first", "second", "is_doubted"), [
    (shank_gravity(), moment_offset(), True),
    (compression(), moment_offset(), True),
    (moment_gain("IE"), moment_offset(), False),  # no moment, no error
    (shank_gravity(), axis_misalignment(), False),
])  # fmt: skip
def test_two_loads_in_every_trial_are_doubted(first: Any, second: Any, is_doubted: bool) -> None:
    best = Loads(names=(first.name, second.name), made=(first, second))
    assert concluded(best).verdict is (Verdict.AMBIGUOUS if is_doubted else Verdict.NAMED)
    assert concluded(Loads(names=(first.name,), made=(first,))).verdict is Verdict.NAMED


@pytest.mark.parametrize("best", [
    Explanation(names=()),
    replace(ONE, misfit_p_value=0.0009),
    replace(ONE, ends=("cause",)),
])  # fmt: skip
def test_what_does_not_fit_or_is_implausible_explains_nothing(best: Explanation) -> None:
    found = concluded(best)
    assert (found.verdict, found.group) == (Verdict.UNEXPLAINED, ())
    assert found.sentence == Verdict.UNEXPLAINED.sentence
    blocked = concluded(best, (rival(3.0, is_finite=False),))
    assert (blocked.verdict, blocked.sentence) == (Verdict.UNEXPLAINED, UNTESTED)


def test_a_cause_that_could_not_be_tested_blocks_the_name_only_if_it_could_matter() -> None:
    blocked = concluded(ONE, (rival(3.0, is_finite=False),))
    assert blocked.verdict is Verdict.AMBIGUOUS
    assert concluded(ONE, (rival(3.0, is_finite=False, score=4.0),)).verdict is Verdict.NAMED


@pytest.mark.parametrize(("degrees", "alarms", "hangs"), [
    (np.inf, {0.75: ALARM, 1.33: 0.2}, True),
    (np.inf, {0.75: ALARM, 1.33: 0.04}, False),
    (60.0, {0.75: ALARM, 1.33: 0.2}, False),  # noise that the data show is not in doubt
])  # fmt: skip
def test_a_verdict_that_hangs_on_a_stated_noise_is_none(
    degrees: float, alarms: dict[float, float], hangs: bool
) -> None:
    base = Explanation(misfit_p_value=0.0, noise_degrees=degrees, alarms=alarms)
    found = concluded(ONE, base=base)
    assert (found.verdict is Verdict.NOT_TESTABLE) is hangs
    assert (found.reasons == (NOISE_DEPENDENT,)) is hangs


@pytest.mark.parametrize(("degrees", "alarms", "said"), [
    (np.inf, {3.0: 0.06, 4.0: 0.3}, " About 3 times the noise stated would."),
    (np.inf, {}, " Nor would 8 times the noise stated: the misfit has a pattern."),
    (60.0, {3.0: 0.06}, ""),  # noise that the data show has its size
])  # fmt: skip
def test_what_nothing_explains_says_how_much_noise_would(
    degrees: float, alarms: dict[float, float], said: str
) -> None:
    base = Explanation(misfit_p_value=0.0, noise_degrees=degrees, alarms=alarms)
    (first, *_) = concluded(Explanation(), base=base).reasons
    rejected, _, more = first.partition(").")
    assert rejected.endswith("(p < 0.001")
    assert more == said


# --- the search ---------------------------------------------------------------------------------


def made_step(at: Explanation, n: int, *, flexible: int = 0, secant: int | None = None) -> Any:
    """Effects 0, 1, ... in the order of their scores, the first of them flexible."""
    sizes = [MOST_AMPLITUDES + (i < flexible) for i in range(n)]
    effects = [
        SimpleNamespace(name=str(i), parameters=SimpleNamespace(n=size))
        for i, size in enumerate(sizes)
    ]
    variants = [SimpleNamespace(effect=x, is_secant=x.name == str(secant)) for x in effects]
    scores = SimpleNamespace(candidates=[scored(x.name, 20.0 - i) for i, x in enumerate(effects)])
    return SimpleNamespace(at=at, variants=variants, scores=scores)


def test_the_eight_highest_are_refitted_and_what_the_score_cannot_judge() -> None:
    names = [x.name for x in _high_scoring(made_step(Explanation(), 12))]
    assert names == [str(i) for i in range(MOST_REFITS)]
    names = [x.name for x in _high_scoring(made_step(Explanation(), 12, secant=11))]
    assert names == [*(str(i) for i in range(MOST_REFITS)), "11"]


def test_beside_a_cause_neither_flexible_effects_nor_secants_are_tried() -> None:
    names = [x.name for x in _high_scoring(made_step(ONE, 12, flexible=2, secant=11))]
    assert names == [str(i) for i in range(2, 2 + MOST_REFITS)]
    first = [x.name for x in _high_scoring(made_step(Explanation(), 12, flexible=2))]
    assert first[:2] == ["0", "1"]


@dataclass(frozen=True)
class Step:
    """A step whose refits are given."""

    at: Explanation
    names: tuple[str, ...]
    refits: tuple[Explanation, ...] = ()
    is_significant: bool = True
    scores: Any = None


def searched(monkeypatch: pytest.MonkeyPatch, refits: Any, names: str) -> Any:
    """An attribution whose refits are `refits` of a step."""

    def step(at: Explanation, effects: Any, _seed: int) -> Step:
        return Step(at, tuple(x.name for x in effects))

    monkeypatch.setattr(naming, "score_candidates", step)
    monkeypatch.setattr(naming, "refit_top_candidates", lambda step, *_: refits(step))
    monkeypatch.setattr(naming, "rivals_of", lambda _best, rest, _looks: tuple(rest))
    effects: Any = [SimpleNamespace(name=x) for x in names]
    base: Any = Explanation()
    return attribute(base, effects, seed=0)


def test_without_simple_effects_the_search_ends_and_evidence_alone_decides(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    many = Explanation(
        names=("m",), misfit_chi2=10.0, log_evidence=30.0, n_amplitudes=MOST_AMPLITUDES + 1
    )
    found = searched(monkeypatch, lambda _step: (many,), "mn")
    assert found.best is many
    # The last step is beside what won, though the search itself had ended at the base model.
    assert [x.at.names for x in found.steps] == [(), ("m",)]
    worse = replace(many, misfit_chi2=95.0)
    kept = searched(monkeypatch, lambda _step: (worse,), "mn")
    assert kept.best is kept.base
    assert kept.rivals == (worse,)


def test_the_search_ends_where_no_effect_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    one = Explanation(names=("a",), misfit_chi2=10.0, log_evidence=30.0)
    found = searched(monkeypatch, lambda _step: (one,), "a")
    assert (found.best, len(found.steps)) == (one, 1)
    assert not found.has_remaining_misfit
