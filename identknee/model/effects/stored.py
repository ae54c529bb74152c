"""Effects stored with a subject: conversion to plain data and back."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from identknee.model.effects.effect import Effect, with_fixed_amplitudes
from identknee.model.effects.library import effect_named
from identknee.model.effects.structures import (
    MissingStructure,
    PosteriorCapsule,
    lines_of,
    structure,
)
from identknee.runs.arrays import Array
from identknee.runs.errors import suggestion
from identknee.subject.effect_choice import EffectChoice
from identknee.subject.knee import Knee


@lru_cache(maxsize=16)
def effects_of(knee: Knee) -> tuple[Effect, ...]:
    """The effects stored with a knee, with its fixed amplitudes fixed.

    Each has the prior of its kind, whatever amplitudes are stored.

    Raises
    ------
    ValueError
        If there is no such effect, it has no such amplitude, or a value is out of its range.
    """
    return tuple(_effect(knee, choice) for choice in knee.effects)


def values_of(knee: Knee) -> dict[str, float]:
    """The amplitudes stored with a knee that vary, by name, such as ``"compression.force_N"``."""
    return {
        f"{x.name}.{name}": value
        for x in knee.effects
        for name, value in x.values.items()
        if name not in x.fixed
    }


def choice_of(
    knee: Knee, effect: Effect, amplitudes: Array, *, fixed: Sequence[str] = ()
) -> EffectChoice:
    """An effect with its amplitudes as a knee can store it.

    Parameters
    ----------
    knee
        The subject on which the effect was placed.
    effect
        Effect of the library, a structure, or one of the knee's own.
    amplitudes
        In the order of the effect's parameters, shape ``(n,)``.
    fixed
        Names of amplitudes, without the effect's, that are not to be calibrated.

    Examples
    --------
    >>> import numpy as np
    >>> from identknee.model.effects.loads import compression
    >>> from identknee.subject.reference import reference_knee
    >>> dict(choice_of(reference_knee(), compression(), np.array([20.0])).values)
    {'force_N': 20.0}
    """
    names = (x.removeprefix(f"{effect.name}.") for x in effect.parameters.names)
    values = {name: float(x) for name, x in zip(names, amplitudes, strict=True)}
    for own in knee.effects:
        if own.name == effect.name:
            both = tuple(dict.fromkeys([*own.fixed, *fixed]))
            return replace(own, values={**own.values, **values}, fixed=both)
    plain = EffectChoice(name=effect.name, values=values, fixed=tuple(fixed))
    if not isinstance(effect, MissingStructure | PosteriorCapsule):
        return plain
    first = effect.medial if isinstance(effect, PosteriorCapsule) else effect
    return replace(
        plain,
        lines=lines_of(knee, effect),
        stiffness_sd_kN=first.stiffness_sd,
        site_sd_mm=first.site_sd if first.sites_vary else 0.0,
    )


def _effect(knee: Knee, choice: EffectChoice) -> Effect:
    if choice.lines:
        sds = {"stiffness_sd": choice.stiffness_sd_kN, "site_sd": choice.site_sd_mm}
        effect: Effect = structure(knee, choice.name, choice.lines, **sds)
    else:
        effect = effect_named(knee, choice.name)
    parameters = effect.parameters
    for name, value in choice.values.items():
        whole = f"{choice.name}.{name}"
        if whole not in parameters.names:
            raise ValueError(
                f"the effect {choice.name} of {knee.name} has no amplitude {name!r}; "
                + suggestion(name, [x.removeprefix(f"{choice.name}.") for x in parameters.names])
            )
        low, high = (
            float(x[parameters.index(whole)]) for x in (parameters.lower, parameters.upper)
        )
        if not low <= value <= high:
            raise ValueError(
                f"{whole} of {knee.name} must be within {low:g} to {high:g}, got {value:g}"
            )
    fixed = {f"{choice.name}.{name}": choice.values[name] for name in choice.fixed}
    return with_fixed_amplitudes(effect, fixed) if fixed else effect
