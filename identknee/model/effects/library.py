"""The library of causes: every effect by its name, placed on the subject's own anatomy."""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from types import MappingProxyType

from identknee.model.effects.bundles import bundles
from identknee.model.effects.contact_law import Cartilage, contact_nuisance, meniscus
from identknee.model.effects.effect import Effect
from identknee.model.effects.facts import FACTS
from identknee.model.effects.frames import femur_frame, flexion_offset, tibia_frame
from identknee.model.effects.history import creep, drift, hysteresis, rig_compliance
from identknee.model.effects.insertion import insertion
from identknee.model.effects.loads import (
    axis_misalignment,
    compression,
    moment_gain,
    moment_offset,
    parasitic_shear,
    shank_gravity,
)
from identknee.model.effects.structures import STIFFNESS_SD, structure
from identknee.model.effects.toe_strain import toe_strain
from identknee.model.effects.wrapping import NAME as WRAPPING
from identknee.model.effects.wrapping import mcl_wrapping
from identknee.runs.errors import suggestion
from identknee.subject.anatomy import anatomy
from identknee.subject.insertion_sites import structure_sites
from identknee.subject.knee import Knee

NEEDS_PHASE, NEEDS_ORDER = frozenset({"hysteresis"}), frozenset({"creep", "drift"})


def library(knee: Knee, *, has_order: bool = False, has_phase: bool = False) -> tuple[Effect, ...]:
    """All causes that can be tried on a subject, in the order of `FACTS`.

    Wrapping of the medial collateral ligament is left out where the subject has no such line, and
    so is a structure where a ligament of the subject is called like it.

    Parameters
    ----------
    knee
        The subject.
    has_order, has_phase
        Whether it is known when each trial was made, and in which phase of loading: what depends on
        it is left out otherwise.

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
    left_out = {x.name for x in knee.ligaments}
    left_out |= {name for name, facts in FACTS.items() if facts.is_numerical}
    if not has_order:
        left_out |= NEEDS_ORDER
    if not has_phase:
        left_out |= NEEDS_PHASE
    if anatomy(knee).medial_collateral is None:
        left_out.add(WRAPPING)
    return tuple(effect_named(knee, x) for x in _MAKERS if x not in left_out)


def effect_named(knee: Knee, name: str) -> Effect:
    """The effect called `name` on a subject, from the library or its nuisances.

    Raises
    ------
    ValueError
        If there is none, or the subject lacks what it acts on.
    """
    if name not in _MAKERS:
        raise ValueError(f"there is no effect {name!r}; {suggestion(name, _MAKERS)}")
    return _MAKERS[name](knee)


def _make_structure(name: str, knee: Knee) -> Effect:
    lines = tuple((x.femur, x.tibia) for x in _sites(knee)[name])
    return structure(knee, name, lines)


_sites = lru_cache(maxsize=4)(structure_sites)
Maker = Callable[[Knee], Effect]


def _make_on_any_subject(make: Callable[[], Effect]) -> Maker:
    """A factory of an effect that is the same on every subject."""
    return lambda _knee: make()


_BY_NAME: dict[str, Maker] = {
    **{name: partial(_make_structure, name) for name in STIFFNESS_SD},
    "bundles": bundles,
    WRAPPING: mcl_wrapping,
    "meniscus": meniscus,
    "toe_strain": _make_on_any_subject(toe_strain),
    "cartilage": _make_on_any_subject(Cartilage),
    "compression": _make_on_any_subject(compression),
    "shank_gravity": _make_on_any_subject(shank_gravity),
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
