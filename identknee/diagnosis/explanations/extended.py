"""The subject with what a fit found, and where its fit lies."""

from collections.abc import Iterable

from identknee.model.effects.effect import Effect
from identknee.model.effects.moved_insertion import MovedInsertion
from identknee.model.effects.remounting import Remounting
from identknee.model.effects.stored import choice_of
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

# What changes the knee given, and is no effect on it.
OF_THE_KNEE = (MovedInsertion, Remounting)


def knee_with(knee: Knee, found: Iterable[tuple[Effect, Array]]) -> Knee:
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


def values_by_owner(model: LaxityModel, theta: Array) -> dict[str, dict[str, float]]:
    """All parameters by owner and name, as in a file of starts for `knee_with`."""
    applied = [x for x in model.effects if isinstance(x, OF_THE_KNEE)]
    left_out = {name for x in applied for name in x.parameters.names}
    tree: dict[str, dict[str, float]] = {}
    for name, value in zip(model.parameters.names, theta.tolist(), strict=True):
        if name not in left_out:
            owner, _, quantity = name.partition(".")
            tree.setdefault(owner, {})[quantity] = value
    return tree
