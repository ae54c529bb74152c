"""Blind cases of a knee intact and cut, on two rigs: an effect of one state, or one rig's error.

All mechanics are those of the separate generator.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from knees import knee

from identknee.blind.case import (
    SD,
    Noise,
    amplitude_for_signal,
    contact_stays_inside,
    rims_of,
    unexplained_norm,
)
from identknee.blind.conditions import STANDARD
from identknee.blind.effects import LISTED
from identknee.blind.experiment import (
    STIFFNESS,
    Experiment,
    ExperimentRun,
    experiment_of,
    parameter_derivatives,
    run_experiment,
)
from identknee.blind.hidden import Hidden, Scene, anatomical_sites
from identknee.diagnosis.investigation import investigate
from identknee.laxity import experiments
from identknee.laxity.experiment_tables import joined
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.runs.declare import Array
from identknee.subject.capsule import with_capsule
from identknee.subject.knee import Knee

ROBOT, HAND, INTACT, CUT, ACL = "robot", "hand", "intact", "cut: ACL", "ACL"
# Rig and state of each table.
TABLES = ((ROBOT, INTACT), (ROBOT, CUT), (HAND, INTACT))
OF_STATE = "cut:ACL"
# Without the ACL the capsule holds these knees near extension only: there under more loads.
FLEXION_DEG = {INTACT: (0.0, 30.0, 60.0), CUT: (0.0,)}
SHARES = {INTACT: (1.0,), CUT: (0.5, 1.0)}
LOADS = ((5.0, 0, 0), (-5.0, 0, 0), (0, 8.0, 0), (0, -8.0, 0), (0, 0, 80.0), (0, 0, -80.0))
SIGNALS = (12.0, 20.0)
STIFFNESS_LOG_SD, STRAIN_SD_PCT, MOST_DRAWS = 0.2, 1.0, 40
STATE_EFFECTS = ("flexion_offset", "femur_frame", "tibia_frame", "moment_offset")
RIG_EFFECTS = (
    "moment_gain_IE",
    "moment_gain_VV",
    "moment_offset",
    "flexion_offset",
    "femur_frame",
    "tibia_frame",
    "rig_compliance_IE",
    "rig_compliance_VV",
)
KNEE_EFFECTS = ("deep_mcl", "popliteofibular", "cartilage", "toe_strain", "meniscus")
ONE_STATE, ONE_RIG, SOUND = "one state", "one rig", "sound"


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """An effect by name and the rig or state that it acts in; none for the whole knee."""

    name: str
    scope: str

    @property
    def cause(self) -> str:
        """As a diagnosis names it."""
        return f"{self.scope}/{self.name}" if self.scope else self.name

    def acts_in(self, rig: str, state: str) -> bool:
        """Whether it acts in a table."""
        return self.scope in ("", rig, state.replace(" ", ""))


def subject(name: str) -> Knee:
    """The knee of a case as the diagnosis knows it: insertions exact, with a capsule."""
    return with_capsule(knee(name))


def planned() -> Laxity:
    """All three tables, without readings."""
    made = []
    for rig, state in TABLES:
        loads = [(0.0, 0.0, 0.0), *(tuple(y * np.array(x)) for x in LOADS for y in SHARES[state])]
        trials = [(flexion, x) for flexion in FLEXION_DEG[state] for x in loads]
        n, name = len(trials), f"{rig} {state.replace(': ', ' ')}"
        protocol = Protocol(
            name=name,
            trials=tuple(f"{name} {i}" for i in range(n)),
            flexion_deg=np.array([flexion for flexion, _ in trials]),
            loads=np.array([[*x, 0.0, 0.0] for _, x in trials]),
            state=(state,) * n,
        )
        table = Laxity(
            protocol=protocol, coordinates=np.full((n, 5), np.nan), sd=np.full((n, 5), SD)
        )
        made.append((experiments.Experiment(name=name, rig=rig, mounting=name), table))
    return joined(made)


def placed_effects(kind: str, number: int) -> tuple[Placed, ...]:
    """What is hidden in a case."""
    if kind == ONE_STATE:
        return (Placed(name=STATE_EFFECTS[number % len(STATE_EFFECTS)], scope=OF_STATE),)
    if kind == ONE_RIG:
        rig = (HAND, ROBOT)[number // len(RIG_EFFECTS) % 2]
        return (
            Placed(name=RIG_EFFECTS[number % len(RIG_EFFECTS)], scope=rig),
            Placed(name=KNEE_EFFECTS[number % len(KNEE_EFFECTS)], scope=""),
        )
    return ()


def state_outcome(name: str, kind: str, number: int, seed: int) -> dict[str, Any]:
    """A case and what the diagnosis says of it, in plain numbers."""
    hidden, own = placed_effects(kind, number), subject(name)
    outcome: dict[str, Any] = {
        "knee": name,
        "kind": kind,
        "seed": seed,
        "hidden": sorted(x.cause for x in hidden),
    }
    wanted = SIGNALS[number // 2 % len(SIGNALS)]
    drawn = _case(own, knee(name), hidden, wanted, np.random.default_rng(seed))
    if drawn is None:
        return {**outcome, "error": f"{MOST_DRAWS} draws left a trial without equilibrium"}
    laxity, signals = drawn
    began = time.process_time()
    found = investigate(own, laxity)
    outcome |= {"signals": signals, "seconds": time.process_time() - began}
    if found is None:
        return {**outcome, "verdict": "NOT_TESTABLE", "named": [], "group": []}
    return {
        **outcome,
        "verdict": found.conclusion.verdict.value,
        "named": sorted(found.explanation.names),
        "group": sorted(found.conclusion.group),
        "p_value": found.conclusion.p_value,
    }


def _case(
    own: Knee,
    bare: Knee,
    hidden: Sequence[Placed],
    wanted: float,
    generator: np.random.Generator,
) -> tuple[Laxity, list[float]] | None:
    """Noisy laxity of all tables and the signal of each effect; None where no draw is stable."""
    laxity, rims = planned(), rims_of(own)
    for _ in range(MOST_DRAWS):
        sound = _drawn_tables(own, laxity, generator)
        stream = int(generator.integers(2**31))
        runs = [run_experiment(x) for x in sound]
        if not all(x.is_complete for x in runs):
            continue
        sized = [_sized(own, bare, (sound, runs), x, wanted, stream) for x in hidden]
        known = [x for x in sized if x is not None]
        if len(known) < len(sized):
            continue
        made = sound
        for drawn, size, _ in known:
            made = [x if y is None else y.apply(x, size) for x, y in zip(made, drawn, strict=True)]
        runs = [run_experiment(x) for x in made]
        inside = zip(made, runs, strict=True)
        if all(x.is_complete for x in runs) and all(
            contact_stays_inside(x, y, rims) for x, y in inside
        ):
            exact = np.concatenate([x.coordinates for x in runs])
            noisy = exact + generator.normal(scale=SD, size=exact.shape)
            return replace(laxity, coordinates=noisy), [signal for _, _, signal in known]
    return None


def _drawn_tables(own: Knee, laxity: Laxity, generator: np.random.Generator) -> list[Experiment]:
    """The sound experiment of each table at values drawn around the subject's, sheets as one."""
    owners = own.owners
    units = {name: generator.standard_normal(2) for name in dict.fromkeys(owners)}
    steps = np.array([units[x] for x in owners])
    k = np.array([x.stiffness_kN for x in own.ligaments]) * np.exp(STIFFNESS_LOG_SD * steps[:, 0])
    strain = np.array([x.reference_strain_pct for x in own.ligaments])
    theta = np.r_[k, strain + STRAIN_SD_PCT * steps[:, 1]]
    cut = np.array([x.name == ACL for x in own.ligaments])
    made = []
    for i, (_, state) in enumerate(TABLES):
        trials = laxity.protocol.select(laxity.protocol.series == i)
        plain = replace(trials, state=None, experiment=None, experiments=())
        experiment = experiment_of(own, plain).with_theta(theta)
        if state == CUT:
            lines = experiment.lines.copy()
            lines[cut, STIFFNESS] = 0.0
            experiment = replace(experiment, lines=lines)
        made.append(experiment)
    return made


def _sized(
    own: Knee,
    bare: Knee,
    sound: tuple[list[Experiment], list[ExperimentRun]],
    placed: Placed,
    wanted: float,
    stream: int,
) -> tuple[list[Hidden | None], float, float] | None:
    """An effect in each table, its signed size and its signal beyond ligament parameters."""
    tables, runs = sound
    drawn: list[Hidden | None] = []
    for (rig, state), table in zip(TABLES, tables, strict=True):
        scene = Scene(
            places=anatomical_sites(bare),
            n_lines=len(own.ligaments),
            start=table.start,
            load_Nm=table.protocol.loads[:, :2],
            order=np.arange(1, table.protocol.n + 1),
            is_unloading=np.zeros(table.protocol.n, bool),
            conditions=STANDARD,
        )
        made = LISTED[placed.name](scene, np.random.default_rng(stream))
        drawn.append(made if placed.acts_in(rig, state) else None)
    one = next(x for x in drawn if x is not None)
    noise = Noise(sd_mm=SD, sd_deg=SD, correlation=0.0)
    slopes = np.concatenate([_slopes(own, x, y) for x, y in zip(tables, runs, strict=True)])

    def signal(amplitude: float) -> float | None:
        changes = []
        for table, run, effect in zip(tables, runs, drawn, strict=True):
            if effect is None:
                changes.append(np.zeros_like(run.coordinates))
                continue
            there = run_experiment(effect.apply(table, one.sign * amplitude), run)
            if not there.is_complete:
                return None
            changes.append(there.coordinates - run.coordinates)
        return unexplained_norm(slopes, np.concatenate(changes), noise)

    found = amplitude_for_signal(signal, signal, wanted, one.largest)
    return None if found is None else (drawn, one.sign * found.amplitude, found.signal)


def _slopes(own: Knee, table: Experiment, run: ExperimentRun) -> Array:
    """Change of the coordinates with factor and strain of each ligament or sheet."""
    m = len(own.ligaments)
    member = np.array([[x == name for name in dict.fromkeys(own.owners)] for x in own.owners])
    slopes = parameter_derivatives(table, run, m)
    by_factor = slopes[:, :, :m] * (0.001 * table.lines[:m, STIFFNESS])
    return np.concatenate([by_factor @ member, slopes[:, :, m:] @ member], axis=2)
