"""The subject with fitted effects, and the start values of its fit."""

from collections.abc import Iterable

from identknee.model.effects.effect import Effect
from identknee.model.effects.insertion import InsertionShift
from identknee.model.effects.remounting import Remounting
from identknee.model.effects.stored import choice_of
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

# What changes the knee given, and is no effect on it.
OF_THE_KNEE = (InsertionShift, Remounting)


def knee_with_effects(knee: Knee, found: Iterable[tuple[Effect, Array]]) -> Knee:
    """The subject whose model has these effects with their amplitudes.

    An insertion found elsewhere is moved there, errors of zero are stated.
    """
    extended, choices = knee, []
    for effect, values in found:
        if isinstance(effect, OF_THE_KNEE):
            extended = effect.applied(extended, values)
        else:
            choices.append(choice_of(knee, effect, values))
    return extended.with_effects(choices)


def values_by_owner(
    effects: Iterable[Effect], parameters: Parameters, theta: Array
) -> dict[str, dict[str, float]]:
    """All parameters by owner and name, as in a file of starts for `knee_with_effects`."""
    applied = [x for x in effects if isinstance(x, OF_THE_KNEE)]
    left_out = {name for x in applied for name in x.parameters.names}
    tree: dict[str, dict[str, float]] = {}
    for name, value in zip(parameters.names, theta.tolist(), strict=True):
        if name not in left_out:
            owner, _, quantity = name.partition(".")
            tree.setdefault(owner, {})[quantity] = value
    return tree
