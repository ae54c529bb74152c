"""One knee in several experiments: what is cut in each, and the errors of its rig and mounting.

The trials of one rig, mounting and state are a part of the model: an ordinary laxity model, with
the parameters that bear on it. Predictions of the whole are put together from those of its parts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from identknee.laxity.experiments import INTACT, Cut, Experiment, cuts_of
from identknee.laxity.protocol import Protocol
from identknee.model.effects.effect import Effect, InputsChange, amplitudes, moves_frames
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.nuisances import stored_effects
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry
from identknee.runs.errors import ValueRefused
from identknee.subject.knee import Knee

if TYPE_CHECKING:
    from identknee.model.laxity_model import LaxityModel, Prediction

# Errors that belong to a rig, and to a mounting of the knee in it, by their names.
OF_RIG, OF_MOUNTING = ("load_gain", "load_axes", "registration"), ("flexion",)
# Standard deviation of the fraction of stiffness that a partial cut takes away.
PARTIAL_CUT_SD = 0.2
CUT = "cut"
OF = "/"
ONE = Experiment(name="all", rig="rig", mounting="mounting")


@declared
class Part:
    """The trials of a model that are of one rig, mounting and state of the knee."""

    model: "LaxityModel" = entry("The model of these trials")
    trials: IntArray = array("Their places among all", "trial", dtype=int)
    columns: IntArray = array("Places of its parameters among all", "parameter", dtype=int)

    def prediction(self, whole: "Prediction") -> "Prediction":
        """Its part of a prediction of the whole."""
        values: dict[str, Any] = {}
        for name in (*OF_TRIALS, *JACOBIANS):
            value = getattr(whole, name)
            values[name] = None if value is None else value[self.trials]
            if value is not None and name in JACOBIANS:
                values[name] = values[name][:, :, self.columns]
        return replace(whole, theta=whole.theta[self.columns], **values)

    def spread(self, values: Array, into: Array) -> None:
        """Put values of its trials, and derivatives by its parameters, among those of all.

        Parameters
        ----------
        values, into
            Of its trials and of all, shape ``(k, ..., p)`` and ``(n, ..., p)``.
        """
        place = np.zeros((*values.shape[:-1], into.shape[-1]))
        # What has no derivatives by its own parameters has none by others.
        place[np.isnan(values).all(axis=-1)] = np.nan
        place[..., self.columns] = values
        into[self.trials] = place


OF_TRIALS = (
    "coordinates",
    "held_coordinates",
    "codes",
    "poses",
    "reached",
    "released",
    "centres",
    "hessians",
)
JACOBIANS = ("jacobian", "held_jacobian", "pose_jacobian")


def parts_of(model: "LaxityModel") -> tuple[Part, ...]:
    """The parts of a model whose protocol has several; empty where all trials are alike.

    Raises
    ------
    ValueError
        If a state names no ligament of the knee, or cuts all of them.
    """
    protocol = model.protocol
    kinds = _kinds(protocol)
    if len(set(kinds)) == 1 and kinds[0][1] == INTACT and not _has_scopes(model.effects):
        return ()
    places = {name: i for i, name in enumerate(model.parameters.names)}
    parts = []
    for kind in dict.fromkeys(kinds):
        experiment, state = kind
        trials = np.array([i for i, x in enumerate(kinds) if x == kind])
        cuts = cuts_of(state)
        scopes = {"", experiment.rig, experiment.mounting, *map(_scope, cuts)}
        own = [x for x in model.effects if scope_of(x) in scopes]
        made = set(map(scope_of, own))
        others = [cut(model.knee, x) for x in cuts if _scope(x) not in made]
        part = replace(
            model,
            protocol=replace(protocol.select(trials), state=None, experiment=None, experiments=()),
            effects=tuple(_renamed(x, _plain_name(x)) for x in (*own, *others)),
            order=None if model.order is None else model.order[trials],
            phase=None if model.phase is None else tuple(model.phase[i] for i in trials),
            poses=None if model.poses is None else model.poses[trials],
            fallback_poses=None if model.fallback_poses is None else model.fallback_poses[trials],
        )
        ligaments = model.parameters.names[: model.n_ligament_parameters]
        names = (*ligaments, *(name for x in own for name in x.parameters.names))
        columns = np.array([places[name] for name in names], dtype=np.int64)
        parts.append(Part(model=part, trials=trials, columns=columns))
    return tuple(parts)


def _kinds(protocol: Protocol) -> list[tuple[Experiment, str]]:
    """Rig and mounting of each trial, as the first experiment with them, and its state."""
    states = (INTACT,) * protocol.n if protocol.state is None else protocol.state
    if protocol.experiment is None:
        first = protocol.experiments[0] if protocol.experiments else ONE
        return [(first, x) for x in states]
    like: dict[tuple[str, str], Experiment] = {}
    of = {x.name: like.setdefault((x.rig, x.mounting), x) for x in protocol.experiments}
    return [(of[name], x) for name, x in zip(protocol.experiment, states, strict=True)]


def _has_scopes(effects: Sequence[Effect]) -> bool:
    return any(map(scope_of, effects))


def scope_of(effect: Effect) -> str:
    """The rig, mounting or partial cut that an effect belongs to; empty for the whole knee."""
    scope, of, _ = effect.name.rpartition(OF)
    return scope if of else ""


def _plain_name(effect: Effect) -> str:
    """Its name in a part, where it is the only one of its kind, or of its ligament."""
    scope, _, kind = effect.name.rpartition(OF)
    return f"{CUT}_{scope}" if kind == CUT else kind


def _scope(cut: Cut) -> str:
    return cut.words.replace(" ", "_")


def cut(knee: Knee, what: Cut) -> InputsChange:
    """A ligament, bundle or group without the fraction of its stiffness that is cut.

    A partial cut has that fraction as a nuisance between 0 and 1.
    """
    groups = {x.name: x.members for x in knee.groups}
    members = groups.get(what.ligament, (what.ligament,))
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


def check_states(knee: Knee, protocol: Protocol) -> None:
    """Refuse states that name no ligament of the knee, or leave it none.

    Raises
    ------
    ValueError
        Naming the first such state.
    """
    groups = {x.name: set(x.members) for x in knee.groups}
    names = {x.name for x in knee.ligaments}
    for state in dict.fromkeys(protocol.state or ()):
        gone: set[str] = set()
        for x in cuts_of(state):
            members = groups.get(x.ligament, {x.ligament})
            if not members <= names:
                raise ValueRefused(
                    f"the state {state!r} cuts {x.ligament}, and {knee.name} has no such ligament",
                    f"name one of {', '.join([*groups, *sorted(names)][:12])}",
                )
            gone |= set() if x.is_partial else members
        if gone == names:
            raise ValueRefused(
                f"the state {state!r} cuts every ligament of {knee.name}",
                "leave out its trials: nothing holds such a knee",
            )


def effects_in_experiments(knee: Knee, protocol: Protocol) -> tuple[Effect, ...]:
    """The effects stored with a knee, those of rigs and mountings once for each of them.

    Errors of one rig are independent of those of another, and so are those of two mountings. A
    partial cut adds the fraction that is cut. With one rig and mounting names stay as they are.
    """
    check_states(knee, protocol)
    experiments = protocol.experiments or (ONE,)
    made: list[Effect] = []
    for effect in stored_effects(knee):
        kind = {**dict.fromkeys(OF_RIG, "rig"), **dict.fromkeys(OF_MOUNTING, "mounting")}
        scopes = _scopes(experiments, kind.get(effect.name, ""))
        is_stated = not effect.parameters.is_of_interest.any()
        made += [_scoped(effect, x) for x in scopes] if scopes and is_stated else [effect]
    return (*made, *_rig_errors(knee, experiments, made), *_partial_cuts(knee, protocol))


def _scopes(experiments: Sequence[Experiment], kind: str) -> list[str]:
    names = list(dict.fromkeys(getattr(x, kind) for x in experiments)) if kind else []
    return names if len(names) > 1 else []


def _rig_errors(
    knee: Knee, experiments: Sequence[Experiment], made: list[Effect]
) -> Iterator[Effect]:
    """Errors that a rig states for itself; they take the place of those of the subject."""
    for x in {x.rig: x for x in experiments if x.uncertainty}.values():
        stated = knee.with_uncertainty(replace(knee.uncertainty, **x.uncertainty))
        for effect in stored_effects(stated):
            if effect.name in OF_RIG:
                scoped = _scoped(effect, x.rig)
                made[:] = [y for y in made if y.name not in (scoped.name, effect.name)]
                yield scoped


def _scoped(effect: Effect, scope: str) -> Effect:
    return _renamed(effect, f"{scope}{OF}{effect.name}")


def _renamed(effect: Effect, name: str) -> Effect:
    """The effect under another name, which the names of its amplitudes begin with."""
    if name == effect.name:
        return effect
    renamed: Any = replace(cast(Any, effect), name=name)
    if moves_frames(effect):
        return cast(Effect, renamed)
    names = tuple(f"{name}.{x.rpartition('.')[2]}" for x in effect.parameters.names)
    return cast(Effect, replace(renamed, parameters=replace(effect.parameters, names=names)))


def _partial_cuts(knee: Knee, protocol: Protocol) -> tuple[Effect, ...]:
    cuts = {x.words: x for state in protocol.state or () for x in cuts_of(state) if x.is_partial}
    return tuple(cut(knee, x) for x in cuts.values())


def merged_prediction(
    parts: Sequence[Part], found: Sequence["Prediction"], theta: Array
) -> "Prediction":
    """The prediction of all trials from those of the parts."""
    n, first = sum(len(x.trials) for x in parts), found[0]
    values: dict[str, Any] = {}
    for name in OF_TRIALS:
        if getattr(first, name) is None:
            values[name] = None
            continue
        own = [np.asarray(getattr(x, name)) for x in found]
        whole = np.empty((n, *own[0].shape[1:]), own[0].dtype)
        for part, x in zip(parts, own, strict=True):
            whole[part.trials] = x
        values[name] = whole
    for name in JACOBIANS:
        values[name] = None
        if getattr(first, name) is not None:
            values[name] = np.zeros((n, 5, theta.size))
            for part, one in zip(parts, found, strict=True):
                part.spread(getattr(one, name), values[name])
    poses = np.concatenate([x.node_poses for x in found])
    return replace(first, theta=np.array(theta, float), node_poses=poses, **values)


def guesses(parts: Sequence[Part], near: "Prediction | None") -> list["Prediction | None"]:
    """The prediction that each part starts from, of one of the whole."""
    if near is None:
        return [None] * len(parts)
    ends = np.cumsum([len(x.model.paths.flexion) for x in parts])[:-1]
    nodes = np.split(near.node_poses, ends)
    return [
        replace(part.prediction(near), node_poses=poses)
        for part, poses in zip(parts, nodes, strict=True)
    ]
