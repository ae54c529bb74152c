"""Other explanations beside the best one: open, excluded, or not tested."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from identknee.diagnosis.refit import Refit, expected_distance
from identknee.diagnosis.score import CandidateScore, Scores
from identknee.runs.outcome import Outcome

# A rival this much less likely is excluded if it could be told apart; beyond the second number
# whether it could or not.
NEAR_EVIDENCE, FAR_EVIDENCE = 6.0, 10.0
LEAST_DISTANCE = 5.0
# What the score of a cause may be by chance, and its share of the highest score: below either a
# cause that could not be fitted would not have explained the data. Of 22 causes hidden one by one
# with a signal of 12 the true one had 0.72 of the highest score or more.
CHANCE, LEAST_SHARE = 0.05, 0.5


class RivalState(StrEnum):
    """What the data say of another explanation."""

    OPEN = "open"
    EXCLUDED = "excluded"
    NOT_TESTED = "not tested"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rival:
    """Another explanation.

    Attributes
    ----------
    refit
        The model with it.
    lead
        By how much the logarithm of its evidence is lower than that of the best explanation.
    distance
        How well the data could tell both apart, see `expected_distance`.
    score
        Of its cause that the best explanation lacks, before any refit; None where that is several.
    highest
        The highest score of the same look.
    """

    refit: Refit
    lead: float
    distance: float
    score: CandidateScore | None
    highest: float

    @property
    def state(self) -> RivalState:
        """Whether the data speak against it clearly enough, if it could be fitted at all.

        A fit that ended before its minimum is taken for as good as a straight model promises that
        it may become: only what is excluded even so is excluded.
        """
        if self.refit.fitted.evaluation.is_finite and not self._is_behind(self.lead):
            return RivalState.OPEN
        undecided = is_undecided(self.refit, self.lead)
        return RivalState.NOT_TESTED if undecided else RivalState.EXCLUDED

    @property
    def is_excluded(self) -> bool:
        """Whether the data speak against it clearly enough."""
        return self.state is RivalState.EXCLUDED

    @property
    def could_matter(self) -> bool:
        """Whether its score leaves it possible that it is the explanation."""
        return self.score is None or could_matter(self.score, self.highest)

    @property
    def reason(self) -> str:
        """Why it was not tested, as a sentence; empty where it was."""
        if self.state is not RivalState.NOT_TESTED:
            return ""
        names = " and ".join(self.refit.names)
        if not self.refit.fitted.evaluation.is_finite:
            why = "from no start had the model a prediction in every measured trial"
        elif self.refit.fitted.outcome is Outcome.CLIFF:
            why = "the way to the best fit is cut where a trial leaves its branch"
        else:
            why = "the fit did not reach a minimum"
        sentence = f"{names} could not be tested: {why}"
        if self.could_matter:
            return f"{sentence}."
        return f"{sentence}; the score before any fit is too low for the explanation."

    def _is_behind(self, lead: float) -> bool:
        if lead > FAR_EVIDENCE:
            return True
        return lead > NEAR_EVIDENCE and self.distance > LEAST_DISTANCE


def is_undecided(refit: Refit, lead: float) -> bool:
    """Whether an explanation so far behind in evidence may still come near, its fit unfinished."""
    if not refit.fitted.evaluation.is_finite:
        return True
    if refit.fitted.outcome is Outcome.MINIMUM:
        return False
    return lead - 0.5 * refit.promised_fall <= FAR_EVIDENCE


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
    return tuple(_rival(best, x, looks) for x in found.values())


def _rival(best: Refit, other: Refit, looks: Sequence[tuple[Refit, Scores]]) -> Rival:
    score, highest = _score(best, other, looks)
    return Rival(
        refit=other,
        lead=best.log_evidence - other.log_evidence,
        distance=expected_distance(best, other),
        score=score,
        highest=highest,
    )


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
