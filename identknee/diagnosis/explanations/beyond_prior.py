"""Insertions that a fit moves beyond what is stated of them: causes to be tried by themselves."""

from dataclasses import dataclass

from identknee.diagnosis.explanations.fitting import Fitted
from identknee.identify.nuisances import IMPROBABLE
from identknee.model.effects.insertion import BONES
from identknee.model.effects.moved_insertion import MovedInsertion, moved_insertion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BeyondPrior:
    """What of the insertions lies beyond its prior.

    Attributes
    ----------
    causes
        The insertions beyond it, each as a cause.
    p_value
        Probability that the farthest of all nuisances lies so far out by chance; 1 without any.
    """

    causes: tuple[MovedInsertion, ...]
    p_value: float


def insertions_beyond(fitted: Fitted) -> BeyondPrior:
    """The insertions that a fit moves farther than 3 standard deviations of what is stated."""
    knee = fitted.model.knee
    places = {f"insertion.{x.name}_{y}": (x.name, y) for x in knee.ligaments for y in BONES}
    groups = fitted.nuisance_groups
    chance = {x.name: len(groups) * x.p_value for x in groups if x.name in places}
    beyond = {name: p_value for name, p_value in chance.items() if p_value < IMPROBABLE}
    return BeyondPrior(
        causes=tuple(moved_insertion(knee, *places[name]) for name in beyond),
        p_value=min(beyond.values(), default=1.0),
    )
