"""Processor time of diagnoses of knees with many parameters."""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from requirement_rows import Measure, Row

from identknee.laxity.protocol import Protocol, concatenate, load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.runs.executors import one_library_thread
from identknee.subject.examples import FOLDER
from identknee.subject.knee import Knee
from identknee.subject.ligament import LigamentGroup
from identknee.subject.opensim import import_opensim
from identknee.verbs.diagnose import diagnose
from identknee.verbs.diagnosis import Diagnosis

GROUPS_S, MEASURED_S = 90.0, 45.0
SEED, NOISE, SHIFT_MM = 3, 0.5, 6.0
UNCERTAIN = "registration=4deg,registration=4mm,insertions=2mm"


def twenty_groups() -> Knee:
    """The 55 bundles of `lenhart2015`, each of its ten ligaments in two halves."""
    whole = import_opensim(FOLDER / "lenhart2015" / "opensim" / "lenhart2015.osim")
    halves = []
    for group in whole.groups:
        middle = (len(group.members) + 1) // 2
        for end, members in (("a", group.members[:middle]), ("b", group.members[middle:])):
            halves.append(LigamentGroup(name=f"{group.name}{end}", members=members))
    return replace(whole, groups=tuple(halves))


def displaced(of: Knee) -> Laxity:
    """75 trials of the knee whose anterior cruciate begins 6 mm more anterior on the femur."""
    flexion, forces = np.repeat([0.0, 30.0, 60.0], 4), np.tile([-100.0, -50.0, 50.0, 100.0], 3)
    drawer = Protocol(
        name="drawer of four sizes",
        trials=tuple(f"{x:g} deg {y:g} N" for x, y in zip(flexion, forces, strict=True)),
        flexion_deg=flexion,
        loads=np.pad(forces[:, None], ((0, 0), (2, 2))),
    )
    trials = concatenate([load_protocol("seed63"), drawer], name="75 trials")
    model = LaxityModel(knee=of, protocol=trials, effects=(effect_named(of, "insertion"),))
    moved = [
        x.startswith("insertion.ACL") and x.endswith("femur_x_mm") for x in model.parameters.names
    ]
    found = model.simulate(np.where(moved, SHIFT_MM, model.parameters.center))
    return add_noise(found, sd_mm=NOISE, sd_deg=NOISE, seed=SEED)


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """Of the verb as a whole, in a process that has compiled."""
    groups = twenty_groups()
    laxity = displaced(groups)
    cases: tuple[tuple[str, float, Callable[[], Diagnosis]], ...] = (
        ("55 bundles in 20 groups, 75 trials", GROUPS_S, lambda: diagnose(groups, laxity)),
        (
            "s192803_bundles, uncertain",
            MEASURED_S,
            lambda: diagnose("s192803_bundles", "s192803", uncertain=UNCERTAIN, noise="1mm,1.5deg"),
        ),
    )
    measures, notes = list[Measure](), list[str]()
    for what, bar, run in cases:
        began = time.process_time()
        with one_library_thread():
            found = run()
        took = time.process_time() - began
        measures.append(Measure(what=f"{what}, processor time", value=took, unit="s", bar=bar))
        notes.append(f"{what}: {found.verdict.value} ({' and '.join(found.cause_names)})")
        yield Row(
            line="diagnose of 55 bundles in 20 groups with 75 trials <= 90 s of processor time; of "
            "s192803_bundles with uncertain registration and insertions <= 45 s",
            measures=measures,
            notes=notes,
        )
