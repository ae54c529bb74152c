"""Fits of the model extended by effects, and which of them the data leave open."""

from collections.abc import Sequence
from dataclasses import field
from enum import StrEnum

import numpy as np

from identknee.diagnosis.fitting import (
    MOST_STEPS,
    BaseFit,
    FittedModel,
    best_fit_from,
    fit_low_loads,
)
from identknee.diagnosis.misfit import (
    cauchy_combination,
    chi2_or_f_test,
    nested_check,
    smooth_patterns,
)
from identknee.diagnosis.score import CandidateScore, Scores
from identknee.identify.laplace import log_evidence
from identknee.model.effects.effect import Effect
from identknee.model.effects.facts import cause_label
from identknee.model.effects.library import knee_with_effects, values_by_owner
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee

# Share of the range of an amplitude: this close to an end it lies on it.
AT_END = 1e-3
# A rival this much less likely is excluded if it could be told apart; beyond the second number
# whether it could or not.
NEAR_EVIDENCE, FAR_EVIDENCE = 6.0, 10.0
LEAST_DISTANCE = 5.0
# What the score of a cause may be by chance, and its share of the highest score: below either a
# cause that could not be fitted would not have explained the data. Of 22 causes hidden one by one
# with a signal of 12 the true one had 0.72 of the highest score or more.
CHANCE, LEAST_SHARE = 0.05, 0.5


@declared
class Refit:
    """The model extended by causes, fitted again."""

    causes: tuple[Effect, ...] = entry(
        "Effects beyond the base model, in the order in which they joined"
    )
    fitted: FittedModel = entry("The fit")
    smooth: Array = entry("Whitened patterns of smooth misfit, shape ``(m, k)``")
    noise_degrees: float = entry("Degrees of freedom of the noise")
    log_evidence: float = field(init=False)
    """Logarithm of the evidence up to a constant of the data; -inf without a prediction."""

    def __post_init__(self) -> None:
        found, evaluation = self.fitted.constrained, self.fitted.evaluation
        value = -np.inf
        if evaluation.is_finite:
            value = log_evidence(evaluation, self.fitted.model.parameters, found.is_held)
        object.__setattr__(self, "log_evidence", value)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(x.name for x in self.causes)

    @property
    def n_base(self) -> int:
        """Parameters of the model without causes; those of the causes come after them."""
        return self.fitted.model.parameters.n - sum(x.parameters.n for x in self.causes)

    @property
    def penalised_chi2(self) -> float:
        """Misfit of the data and how far the base parameters left their prior, as a chi-square."""
        rows = self.fitted.evaluation.residuals[: self.fitted.n_data + self.n_base]
        return float(rows @ rows)

    @property
    def misfit_p_value(self) -> float:
        """Probability of so much misfit under noise: its size and its smooth part together."""
        return self.misfit_p_value_at(1.0)

    def misfit_p_value_at(self, factor: float) -> float:
        """The same if the noise were so many times as large; 0 without a prediction."""
        if not self.fitted.evaluation.is_finite:
            return 0.0
        rows, projector = self.fitted.residual_rows() / factor, self.fitted.projector
        # Not projected: a fit that ended before its minimum must not seem better than it is.
        whole = chi2_or_f_test(float(rows @ rows), projector.degrees_of_freedom, self.noise_degrees)
        wider = projector.with_columns(projector.padded(self.smooth))
        smooth = nested_check(rows, projector, wider, noise_degrees=self.noise_degrees)
        return cauchy_combination([whole.p_value, smooth.p_value])

    def alarm_p_value(self, library_p_value: float, noise_factor: float = 1.0) -> float:
        """Probability of a misfit as clear under noise: library, size and shape together.

        The library's largest score is the sharpest of the three tests and counts three times as
        much.

        Parameters
        ----------
        library_p_value
            Probability of the largest score, which does not depend on the size of the noise.
        noise_factor
            Noise over the noise that the fit was made with.
        """
        return cauchy_combination([*3 * [library_p_value], self.misfit_p_value_at(noise_factor)])

    @property
    def promised_fall(self) -> float:
        """Further reduction of the deviance by the linear model; inf without a prediction."""
        evaluation = self.fitted.evaluation
        if not evaluation.is_finite:
            return np.inf
        free = ~self.fitted.constrained.is_held
        jacobian = evaluation.jacobian[:, free]
        gradient = jacobian.T @ evaluation.residuals
        return float(gradient @ np.linalg.solve(jacobian.T @ jacobian, gradient))

    def amplitudes(self, name: str) -> Array:
        """Fitted amplitudes of the cause called `name`."""
        return np.asarray(self.fitted.theta[self.places(name)])

    @property
    def extended_knee(self) -> Knee:
        """The subject whose model has the effects of the fit, each with the amplitudes found.

        An insertion found elsewhere is moved there. Ligaments keep the values that the subject came
        with: priors are centred on them, and data used for both prior and likelihood would count
        twice. A search starts at the fit with `fitted_values`.
        """
        model = self.fitted.model
        return knee_with_effects(model.knee, [(x, self._values(x)) for x in model.effects])

    @property
    def fitted_values(self) -> dict[str, dict[str, float]]:
        """All parameters by owner and name, as in a file of starts for `extended_knee`."""
        model = self.fitted.model
        return values_by_owner(model.effects, model.parameters, self.fitted.theta)

    def covariance(self) -> Array:
        """Covariance of all parameters, priors included, shape ``(p, p)``."""
        jacobian = self.fitted.evaluation.jacobian
        return np.asarray(np.linalg.inv(jacobian.T @ jacobian))

    def places(self, name: str) -> Array:
        """Where the amplitudes of the cause called `name` stand in theta."""
        cause = next(x for x in self.causes if x.name == name)
        return np.array([self.fitted.model.parameters.index(x) for x in cause.parameters.names])

    def _values(self, effect: Effect) -> Array:
        p = self.fitted.model.parameters
        return np.asarray(self.fitted.theta[[p.index(x) for x in effect.parameters.names]])

    def is_at_range_end(self, name: str) -> bool:
        """Whether an amplitude lies at a non-zero end of its plausible range."""
        p, places = self.fitted.model.parameters, self.places(name)
        value, low, high = self.fitted.theta[places], p.lower[places], p.upper[places]
        margin = AT_END * (high - low)
        return bool(np.any((value > high - margin) | ((value < low + margin) & (low < 0.0))))


def without_causes(base: BaseFit) -> Refit:
    """The fit of the base model, the reference of comparisons."""
    fitted, protocol = base.fitted, base.fitted.laxity.protocol
    patterns = smooth_patterns(protocol.loads, protocol.flexion_deg, fitted.laxity.is_measured)
    return Refit(
        causes=(),
        fitted=fitted,
        smooth=fitted.noise.whiten(patterns),
        noise_degrees=base.noise.degrees_of_freedom,
    )


def refit(
    base: Refit,
    causes: Sequence[Effect],
    starts: Sequence[Array],
    *,
    most_steps: int = MOST_STEPS,
    beside: Sequence[Refit] = (),
) -> Refit:
    """The base model with these causes, fitted from `starts`, each of all its parameters.

    Parameters
    ----------
    base
        The fit without causes.
    causes
        The effects to add.
    starts
        Each shape ``(p,)``.
    most_steps
        Steps of each fit at most.
    beside
        Refits with the same causes: one that joins them is not continued.
    """
    model = base.fitted.model
    extended = model.with_effects([*model.effects, *causes])
    fitted = best_fit_from(
        extended,
        base.fitted.laxity,
        base.fitted.noise,
        starts,
        most_steps=most_steps,
        ends=[x.fitted.evaluation for x in beside],
    )
    return Refit(
        causes=tuple(causes),
        fitted=fitted,
        smooth=base.smooth,
        noise_degrees=base.noise_degrees,
    )


def refit_via_low_loads(base: Refit, stuck: Refit, start: Array) -> Refit:
    """A refit restarted from a fit to the trials of low loads.

    Parameters
    ----------
    base
        The fit without causes.
    stuck
        The refit that did not reach its minimum.
    start
        Where the fit to low loads begins, shape ``(p,)``.
    """
    fitted = stuck.fitted
    low = fit_low_loads(fitted.model, fitted.laxity, fitted.noise, start)
    return refit(base, stuck.causes, [low])


def expected_distance(true: Refit, rival: Refit) -> float:
    """How far the rival would stay from data that follow `true` without noise, in units of noise.

    The square is the chi-square that the rival's best fit to such data would leave, to first order
    around its own fit. Beyond 5 the rival would hardly ever be taken for the truth.
    """
    if not rival.fitted.evaluation.is_finite:
        return np.inf
    measured = rival.fitted.n_data
    difference = (
        rival.fitted.evaluation.residuals[:measured] - true.fitted.evaluation.residuals[:measured]
    )
    return float(np.linalg.norm(rival.fitted.projector.project(difference)))


class RivalState(StrEnum):
    """The state of another explanation given the data."""

    OPEN = "open"
    EXCLUDED = "excluded"
    NOT_TESTED = "not tested"


@declared
class Rival:
    """Another explanation."""

    refit: Refit = entry("The model with it")
    log_evidence_deficit: float = entry(
        "By how much the logarithm of its evidence is lower than that of the best explanation"
    )
    distance: float = entry("How well the data could tell both apart, see `expected_distance`")
    score: CandidateScore | None = entry(
        "Score of its cause that the best explanation lacks, before any refit; None where it lacks "
        "several"
    )
    highest: float = entry("The highest score of the same look")

    @property
    def state(self) -> RivalState:
        """Whether the data speak against it clearly enough, if it could be fitted at all.

        A fit that ended before its minimum is taken for as good as a straight model promises that
        it may become: only what is excluded even so is excluded.
        """
        if self.refit.fitted.evaluation.is_finite and not self._is_behind(
            self.log_evidence_deficit
        ):
            return RivalState.OPEN
        undecided = is_undecided(self.refit, self.log_evidence_deficit)
        return RivalState.NOT_TESTED if undecided else RivalState.EXCLUDED

    @property
    def is_excluded(self) -> bool:
        """Whether the data exclude it."""
        return self.state is RivalState.EXCLUDED

    @property
    def could_matter(self) -> bool:
        """Whether it may be the explanation by its score."""
        return self.score is None or could_matter(self.score, self.highest)

    @property
    def reason(self) -> str:
        """The reason it was not tested, as a sentence; empty if it was."""
        if self.state is not RivalState.NOT_TESTED:
            return ""
        names = " and ".join(map(cause_label, self.refit.names))
        if not self.refit.fitted.evaluation.is_finite:
            why = "at no start did the model have an equilibrium in every measured trial"
        elif self.refit.fitted.outcome is Outcome.CLIFF:
            why = "the way to the best fit is cut where a trial leaves its branch"
        else:
            why = "the fit did not reach a minimum"
        sentence = f"The {names} could not be tested: {why}"
        if self.could_matter:
            return f"{sentence}."
        return f"{sentence}; the score before any fit is too low for the explanation."

    def _is_behind(self, deficit: float) -> bool:
        if deficit > FAR_EVIDENCE:
            return True
        return deficit > NEAR_EVIDENCE and self.distance > LEAST_DISTANCE


def is_undecided(refit: Refit, deficit: float) -> bool:
    """Whether an explanation so far behind in evidence may still come near, its fit unfinished."""
    if not refit.fitted.evaluation.is_finite:
        return True
    if refit.fitted.outcome is Outcome.MINIMUM:
        return False
    return deficit - 0.5 * refit.promised_fall <= FAR_EVIDENCE


def could_matter(score: CandidateScore, highest: float) -> bool:
    """Whether a cause that was not fitted could still be the explanation, by its score alone."""
    return score.p_value <= CHANCE and score.score >= LEAST_SHARE * highest


def rivals_of(
    best: Refit, others: Sequence[Refit], looks: Sequence[tuple[Refit, Scores]]
) -> tuple[Rival, ...]:
    """The other explanations, each set of causes once, the most likely first.

    Parameters
    ----------
    best
        The best explanation.
    others
        Refits of others.
    looks
        The fits looked at, the base model first, with the scores beside each.
    """
    found: dict[frozenset[str], Refit] = {}
    for x in sorted(others, key=lambda x: -x.log_evidence):
        if set(x.names) != set(best.names):
            found.setdefault(frozenset(x.names), x)
    rivals = []
    for x in found.values():
        score, highest = _score(best, x, looks)
        rivals.append(
            Rival(
                refit=x,
                log_evidence_deficit=best.log_evidence - x.log_evidence,
                distance=expected_distance(best, x),
                score=score,
                highest=highest,
            )
        )
    return tuple(rivals)


def _score(
    best: Refit, other: Refit, looks: Sequence[tuple[Refit, Scores]]
) -> tuple[CandidateScore | None, float]:
    """The score of the one cause that `best` lacks, beside the others' if they were looked at."""
    own = [x for x in other.names if x not in best.names]
    if len(own) != 1:
        return None, 0.0
    shared = set(other.names) - {own[0]}
    beside = next((scores for at, scores in looks if set(at.names) == shared), looks[0][1])
    score = next((x for x in beside.candidates if x.name == own[0]), None)
    return score, beside.max_score
