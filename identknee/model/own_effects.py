"""The effects that a knee brings to its model: those stored with it, then its stated errors."""

from identknee.model.effects.effect import Effect
from identknee.model.effects.stored import effects_of
from identknee.model.nuisances.library import held_errors, nuisances_of
from identknee.subject.knee import Knee


class StoredWithKnee(tuple[Effect, ...]):
    """Stands for the effects and nuisances of the knee where a model is given none."""

    __slots__ = ()


def own_effects(knee: Knee) -> tuple[Effect, ...]:
    """The effects stored with a knee, then its nuisances.

    An effect that is both is one mechanism: it has the prior of the nuisance, or is held where the
    knee states none.
    """
    errors = (*held_errors(knee), *nuisances_of(knee))
    names = {x.name for x in errors}
    if any(x.name in names for x in knee.effects):
        knee = knee.with_effects([x for x in knee.effects if x.name not in names])
    return (*effects_of(knee), *errors)
