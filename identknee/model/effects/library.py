"""The library of causes: every effect by its name, placed on a subject and stored with it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType

from identknee.model.effects.effect import OF, Effect, scoped, with_fixed_amplitudes
from identknee.model.effects.facts import FACTS
from identknee.model.effects.loads import (
    axis_misalignment,
    compression,
    moment_gain,
    moment_offset,
    muscle_tension,
    parasitic_shear,
    shank_gravity,
)
from identknee.model.effects.readings import (
    Remounting,
    creep,
    drift,
    femur_frame,
    flexion_offset,
    hysteresis,
    rig_compliance,
    tibia_frame,
)
from identknee.model.effects.structures import (
    CAPSULE,
    STIFFNESS_SD,
    MissingStructure,
    PosteriorCapsule,
    lines_of,
    structure,
)
from identknee.model.effects.tissues import (
    BUNDLES,
    WRAPPING,
    Cartilage,
    InsertionShift,
    LigamentBundles,
    bundles,
    bundles_of_each,
    contact_nuisance,
    insertion,
    mcl_wrapping,
    meniscal_wedge,
    meniscus,
    toe_strain,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.runs.errors import suggestion
from identknee.subject.anatomy import anatomy
from identknee.subject.capsule import SHEETS
from identknee.subject.insertion_sites import structure_sites
from identknee.subject.knee import EffectChoice, Knee
from identknee.subject.menisci import MENISCI, plateaus_without_rim
from identknee.subject.plausibility import OTHER_NAMES

# Sheets of a subject's own capsule that replace a structure of the library.
COVERED: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "anterolateral": frozenset({SHEETS["anterolateral"].group}),
        "posteromedial": frozenset({SHEETS["posteromedial"].group}),
        CAPSULE: frozenset(SHEETS[x].group for x in ("posteromedial", "posterolateral")),
    }
)
NEEDS_PHASE, NEEDS_ORDER = frozenset({"hysteresis"}), frozenset({"creep", "drift"})


def library(knee: Knee, *, has_order: bool = False, has_phase: bool = False) -> tuple[Effect, ...]:
    """All causes that can be tried on a subject, in the order of `FACTS`.

    Wrapping of the medial collateral ligament is left out where the subject has no such ligament or
    it wraps already, menisci where a plateau has no rim, and a structure where a ligament of the
    subject has its name or sheets of its capsule replace it. Where the subject's ligaments are
    groups of lines, bundles of each ligament are a cause of their own, all of the same name.

    Parameters
    ----------
    knee
        The subject.
    has_order, has_phase
        Whether the order and the phase of loading of the trials are known. Effects that depend on
        them are left out otherwise.

    Raises
    ------
    ValueError
        If the femoral surface has no posterior condyle on one side.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> [x.name for x in library(reference_knee())][:3]
    ['anterolateral', 'posteromedial', 'popliteofibular']
    """
    left_out = {*STIFFNESS_SD} - {*lacking_structures(knee)}
    left_out |= {x.name for x in knee.ligaments}
    left_out |= {name for name, facts in FACTS.items() if facts.is_numerical}
    if not has_order:
        left_out |= NEEDS_ORDER
    if not has_phase:
        left_out |= NEEDS_PHASE
    medial = anatomy(knee).medial_collateral
    if medial is None or knee.ligament(medial).wrap is not None:
        left_out.add(WRAPPING)
    if plateaus_without_rim(knee):
        left_out.add(MENISCI)
    named: dict[str, tuple[Effect, ...]] = {
        name: (effect_named(knee, name),) for name in _MAKERS if name not in left_out
    }
    if knee.groups:
        named[BUNDLES] = bundles_of_each(knee)
    return tuple(effect for each in named.values() for effect in each)


def lacking_structures(knee: Knee) -> tuple[str, ...]:
    """Names of the structures of the library that a knee has not, also not under another name."""
    groups, ligaments = {x.name for x in knee.groups}, [x.name for x in knee.ligaments]
    present = {*ligaments, *(name for name, sheets in COVERED.items() if sheets <= groups)}
    present |= {
        name for name, own in OTHER_NAMES.items() if any(x.startswith(own) for x in ligaments)
    }
    return tuple(x for x in STIFFNESS_SD if x not in present)


def structures_lacking(knee: Knee, share: float) -> tuple[Effect, ...]:
    """Those structures as nuisances, their stiffness with this share of its usual prior's scale."""
    return tuple(
        structure(
            knee,
            name,
            [(x.femur, x.tibia) for x in _sites(knee)[name]],
            stiffness_sd=share * STIFFNESS_SD[name],
            is_nuisance=True,
        )
        for name in lacking_structures(knee)
    )


def effect_named(knee: Knee, name: str) -> Effect:
    """The effect called `name` on a subject, from the library or its nuisances.

    Raises
    ------
    ValueError
        If there is no such effect, or the subject lacks the structure that it acts on.
    """
    scope, _, own = name.rpartition(OF)
    if own not in _MAKERS:
        raise ValueError(f"there is no effect {name!r}; {suggestion(name, _MAKERS)}")
    return scoped(_MAKERS[own](knee), scope) if scope else _MAKERS[own](knee)


def _make_structure(name: str, knee: Knee) -> Effect:
    return structure(knee, name, tuple((x.femur, x.tibia) for x in _sites(knee)[name]))


_sites = lru_cache(maxsize=4)(structure_sites)
Maker = Callable[[Knee], Effect]


def _make_on_any_subject(make: Callable[[], Effect]) -> Maker:
    """A factory of an effect that does not depend on the subject."""
    return lambda _knee: make()


_BY_NAME: dict[str, Maker] = {
    **{name: partial(_make_structure, name) for name in STIFFNESS_SD},
    BUNDLES: bundles,
    WRAPPING: mcl_wrapping,
    "meniscus": meniscus,
    MENISCI: _make_on_any_subject(meniscal_wedge),
    "toe_strain": _make_on_any_subject(toe_strain),
    "cartilage": _make_on_any_subject(Cartilage),
    "compression": _make_on_any_subject(compression),
    "shank_gravity": _make_on_any_subject(shank_gravity),
    "muscle_tension": muscle_tension,
    "moment_gain_IE": _make_on_any_subject(partial(moment_gain, "IE")),
    "moment_gain_VV": _make_on_any_subject(partial(moment_gain, "VV")),
    "moment_offset": _make_on_any_subject(moment_offset),
    "axis_misalignment": _make_on_any_subject(axis_misalignment),
    "parasitic_shear": _make_on_any_subject(parasitic_shear),
    "femur_frame": _make_on_any_subject(femur_frame),
    "tibia_frame": _make_on_any_subject(tibia_frame),
    "flexion_offset": _make_on_any_subject(flexion_offset),
    "rig_compliance_IE": _make_on_any_subject(partial(rig_compliance, "IE")),
    "rig_compliance_VV": _make_on_any_subject(partial(rig_compliance, "VV")),
    "insertion": insertion,
    "hysteresis": _make_on_any_subject(hysteresis),
    "creep": _make_on_any_subject(creep),
    "drift": _make_on_any_subject(drift),
    "contact_law": _make_on_any_subject(contact_nuisance),
}
_MAKERS: Mapping[str, Maker] = MappingProxyType(
    {name: _BY_NAME[name] for name in FACTS if name in _BY_NAME}
)


@lru_cache(maxsize=16)
def effects_of(knee: Knee) -> tuple[Effect, ...]:
    """The effects stored with a knee, with its fixed amplitudes fixed.

    Priors are those of the library and do not depend on the stored amplitudes.

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
        Amplitudes in the order of the effect's parameters, shape ``(n,)``.
    fixed
        Names of amplitudes, without that of the effect, that stay fixed in calibrations.

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
    if isinstance(effect, LigamentBundles):
        # The other ligaments stay as they are.
        rest = {x.removeprefix(f"{effect.name}."): 0.0 for x in effect.whole.parameters.names}
        fixed = (*fixed, *(x for x in rest if x not in values))
        values = {**rest, **values}
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
        effect: Effect = structure(
            knee,
            choice.name,
            choice.lines,
            stiffness_sd=choice.stiffness_sd_kN,
            site_sd=choice.site_sd_mm,
        )
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


# Names that stand for a change of the knee itself, not for an effect.
OF_THE_KNEE = (InsertionShift, Remounting)


def knee_with_effects(knee: Knee, found: Iterable[tuple[Effect, Array]]) -> Knee:
    """The subject whose model has these effects with their amplitudes.

    A shifted insertion is moved in the knee, and errors of remounting become stated errors of zero.
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
