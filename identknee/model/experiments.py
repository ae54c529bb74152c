"""One knee in several experiments: what is cut in each, and the errors of its rig and mounting.

All trials share the parameters of the ligaments. Errors of a rig or a mounting, and fractions of
partial cuts, are named ``scope/name``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from identknee.laxity.experiments import INTACT, LOAD_CELL, Cut, Experiment, cuts_of
from identknee.laxity.protocol import Protocol
from identknee.model.effects.effect import (
    OF,
    Effect,
    InputsChange,
    amplitudes,
    renamed,
    scope_of,
    scoped,
    with_fixed_amplitudes,
)
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.nuisances import load_cell, stored_effects
from identknee.runs.declare import Array, IntArray
from identknee.runs.errors import ValueRefused
from identknee.subject.knee import Knee

# Names of the errors that belong to a rig, to a mounting of the knee in it, and to a state.
OF_RIG, OF_MOUNTING = ("load_gain", "load_axes", "registration"), ("flexion",)
OF_STATE = ("state_elongation", "state_drift")
# Names of the causes that belong to a rig.
CAUSES_OF_RIG = (
    "moment_gain_IE",
    "moment_gain_VV",
    "moment_offset",
    "axis_misalignment",
    "parasitic_shear",
    "femur_frame",
    "tibia_frame",
    "flexion_offset",
    "rig_compliance_IE",
    "rig_compliance_VV",
    "hysteresis",
)
# Causes that may begin when a knee is taken out of its rig to be cut.
CAUSES_OF_STATE = ("flexion_offset", "femur_frame", "tibia_frame", "moment_offset")
# A comparison of two rigs shows gain errors larger than anyone would expect of one rig.
GAINS, GAIN_SD, GAIN_LIMITS = CAUSES_OF_RIG[:2], 0.3, (-0.9, 1.5)
# Standard deviation of the fraction of stiffness that a partial cut takes away.
PARTIAL_CUT_SD = 0.2
CUT = "cut"
# Stands for the experiment of a protocol that names none.
ONE = Experiment(name="all", rig="rig", mounting="mounting")


def kinds_of_trials(protocol: Protocol) -> list[tuple[Experiment, str]]:
    """Experiment and state of each trial; the first of all that share a rig and a mounting."""
    if protocol.experiment is None:
        first = protocol.experiments[0] if protocol.experiments else ONE
        return [(first, x) for x in protocol.states]
    like: dict[tuple[str, str], Experiment] = {}
    of = {x.name: like.setdefault((x.rig, x.mounting), x) for x in protocol.experiments}
    return [(of[name], x) for name, x in zip(protocol.experiment, protocol.states, strict=True)]


def effects_of_part(
    knee: Knee, effects: Sequence[Effect], experiment: Experiment, state: str
) -> tuple[list[Effect], tuple[Effect, ...]]:
    """Which of a model's effects act in an experiment and a state, and how they act there.

    Returns
    -------
    own
        The effects of the whole knee, of the rig, of the mounting, of the state and of the cuts.
    acting
        The same effects, the first of each kind under its plain name, then the cuts that the model
        has no effect for, at their stated fraction.
    """
    cuts = cuts_of(state)
    scopes = {"", experiment.rig, experiment.mounting, _state_scope(state), *map(_scope, cuts)}
    own = [x for x in effects if scope_of(x) in scopes]
    made = set(map(scope_of, own))
    stated = [_as_stated(cut(knee, x)) for x in cuts if _scope(x) not in made]
    acting: dict[str, Effect] = {}
    for x in (*own, *stated):
        # One of a rig and one of a state may act at once: the second is named after both.
        name = _plain_name(x)
        name = x.name.replace(OF, " ") if name in acting else name
        acting[name] = renamed(x, name)
    return own, tuple(acting.values())


def _as_stated(effect: Effect) -> Effect:
    parameters = effect.parameters
    values = dict(zip(parameters.names, parameters.center.tolist(), strict=True))
    return with_fixed_amplitudes(effect, values) if values else effect


def _plain_name(effect: Effect) -> str:
    """Name of an effect without its scope; a cut keeps the name of its ligament."""
    scope, _, kind = effect.name.rpartition(OF)
    return f"{CUT}_{scope}" if kind == CUT else kind


def _scope(cut: Cut) -> str:
    return cut.words.replace(" ", "_")


def _state_scope(state: str) -> str:
    return state.replace(" ", "")


def cut(knee: Knee, what: Cut) -> InputsChange:
    """A ligament, bundle or group without the fraction of its stiffness that is cut.

    A partial cut has that fraction as a nuisance between 0 and 1.
    """
    members = members_of(knee, what.ligament)
    owners = np.array([i for i, x in enumerate(knee.ligaments) if x.name in members])
    name = f"{_scope(what)}{OF}{CUT}"
    sd = [PARTIAL_CUT_SD] if what.is_partial else []
    made = amplitudes(
        name,
        ["fraction"] * len(sd),
        sd,
        lower=[0.0] * len(sd),
        upper=[1.0] * len(sd),
        center=[what.fraction] * len(sd),
    )
    return InputsChange(
        name=name, parameters=made.as_nuisances(), changed=partial(_without, owners)
    )


def _without(owners: IntArray, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    fraction = float(values[0]) if values.size else 1.0
    left = np.where(np.isin(setting.owner, owners), 1.0 - fraction, 1.0)
    return replace(setting, stiffness=left * setting.stiffness, share=left * setting.share)


def members_of(knee: Knee, name: str) -> frozenset[str]:
    """Names of the bundles of a group, or the name itself where it is a ligament."""
    return frozenset(next((x.members for x in knee.groups if x.name == name), (name,)))


def gone_in(knee: Knee, state: str) -> frozenset[str]:
    """The ligaments and bundles that are cut through in a state."""
    gone = (members_of(knee, x.ligament) for x in cuts_of(state) if not x.is_partial)
    return frozenset().union(*gone)


def check_states(knee: Knee, protocol: Protocol) -> None:
    """Refuse states that the knee cannot have.

    Raises
    ------
    ValueError
        If a state cuts a ligament that the knee lacks, or all ligaments, or if an experiment is of
        the other side.
    """
    for one in protocol.experiments or ():
        if one.side and one.side != knee.side:
            raise ValueRefused(
                f"{one.name} is of a {one.side} knee, and {knee.name} is a {knee.side} one",
                "give the tables of one side",
            )
    groups = [x.name for x in knee.groups]
    names = {x.name for x in knee.ligaments}
    for state in dict.fromkeys(protocol.state or ()):
        for x in cuts_of(state):
            if not members_of(knee, x.ligament) <= names:
                raise ValueRefused(
                    f"the state {state!r} cuts {x.ligament}, and {knee.name} has no such ligament",
                    f"name one of {', '.join([*groups, *sorted(names)][:12])}",
                )
        if gone_in(knee, state) == names:
            raise ValueRefused(
                f"the state {state!r} cuts every ligament of {knee.name}",
                "leave out its trials: nothing holds such a knee",
            )


def effects_in_experiments(knee: Knee, protocol: Protocol) -> tuple[Effect, ...]:
    """The effects stored with a knee, with a copy for each rig or mounting where there are several.

    Errors of two rigs are independent of each other, and so are those of two mountings. Changes
    between states are counted from the intact knee, with a copy for each other state. A partial cut
    adds the fraction that is cut. With a single rig or mounting names have no scope.
    """
    check_states(knee, protocol)
    experiments = protocol.experiments or (ONE,)
    made: list[Effect] = []
    for effect in stored_effects(knee):
        if effect.name in OF_STATE:
            cut_states = (x for x in dict.fromkeys(protocol.state or ()) if x != INTACT)
            made += [scoped(effect, _state_scope(x)) for x in cut_states]
            continue
        kind = {**dict.fromkeys(OF_RIG, "rig"), **dict.fromkeys(OF_MOUNTING, "mounting")}
        scopes = _scopes(experiments, kind.get(effect.name, ""))
        is_stated = not effect.parameters.is_of_interest.any()
        made += [scoped(effect, x) for x in scopes] if scopes and is_stated else [effect]
    stated = tuple(_rig_errors(knee, experiments))
    replaced = {y for x in stated for y in (x.name, x.name.rpartition(OF)[2])}
    kept = (x for x in made if x.name not in replaced)
    cuts = {x.words: x for state in protocol.state or () for x in cuts_of(state) if x.is_partial}
    return (*kept, *stated, *(cut(knee, x) for x in cuts.values()))


def _scopes(experiments: Sequence[Experiment], kind: str) -> list[str]:
    names = list(dict.fromkeys(getattr(x, kind) for x in experiments)) if kind else []
    return names if len(names) > 1 else []


def _rig_errors(knee: Knee, experiments: Sequence[Experiment]) -> Iterator[Effect]:
    """Errors that a rig states for itself, in place of those stated for the subject."""
    for x in {x.rig: x for x in experiments if x.uncertainty}.values():
        own = {k: size for k, size in x.uncertainty.items() if k not in LOAD_CELL}
        stated = knee.with_uncertainty(replace(knee.uncertainty, **own))
        for effect in stored_effects(stated) if own else ():
            if effect.name in OF_RIG:
                yield scoped(effect, x.rig)
        if any(cell := [x.uncertainty.get(part, 0.0) for part in LOAD_CELL]):
            yield scoped(load_cell(*cell), x.rig)


def causes_in_experiments(effects: Sequence[Effect], protocol: Protocol) -> tuple[Effect, ...]:
    """Candidate causes, with a copy for each rig where there are several.

    Causes that may begin when the knee is cut also have a copy for each cut state, if there are
    trials in another state to compare with.
    """
    rigs = _scopes(protocol.experiments, "rig")
    states = dict.fromkeys(protocol.state or ())
    cut_states = [_state_scope(x) for x in states if x != INTACT] if len(states) > 1 else []
    return tuple(each for x in effects for each in _in_experiments(x, rigs, cut_states))


def _in_experiments(
    effect: Effect, rigs: Sequence[str], cut_states: Sequence[str]
) -> Iterator[Effect]:
    if rigs and effect.name in CAUSES_OF_RIG:
        yield from (_of_one_rig(effect, rig) for rig in rigs)
    else:
        yield effect
    if effect.name in CAUSES_OF_STATE:
        yield from (scoped(effect, state) for state in cut_states)


def _of_one_rig(effect: Effect, rig: str) -> Effect:
    made = scoped(effect, rig)
    if effect.name not in GAINS:
        return made
    parameters = replace(
        made.parameters,
        prior_sd=np.full(1, GAIN_SD),
        lower=np.full(1, GAIN_LIMITS[0]),
        upper=np.full(1, GAIN_LIMITS[1]),
    )
    wider: Any = replace(made, parameters=parameters)  # type: ignore[type-var]
    return wider  # type: ignore[no-any-return]
