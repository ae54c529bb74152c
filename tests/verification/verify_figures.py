"""Every figure of every verb, for all named subjects and two forms of a measured table.

Results are kept in `KEPT` and drawn anew by the next run; delete the folder to compute them anew.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from figure_checks import faults_of
from held import fixing
from requirement_rows import Measure, Row
from typer.testing import CliRunner

import identknee as ik
from identknee.cli.app import app
from identknee.laxity.protocol import Protocol, trial_name
from identknee.laxity.table import Laxity, add_noise, example_laxity, write_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.subject.examples import NAMED_SUBJECTS
from identknee.subject.knee import Knee

ANGLES = (10.0, 40.0)
# By place among the loads, their sizes.
LOADS = {0: (-4.0, 0.0, 4.0), 1: (-5.0, 5.0), 2: (-60.0, 60.0)}
NOISE = "0.5mm,0.5deg"
COMPRESSION_N, STRAY_N, STRAY_DEG = -20.0, 1.0, 1.5
FORMS = ("one angle for all", "as a rig reads it")
KEPT = Path(tempfile.gettempdir()) / "identknee_verification" / "figures"


def grid() -> Protocol:
    """A few loads of each kind at two angles."""
    rows = []
    for angle in ANGLES:
        for axis, sizes in LOADS.items():
            rows += [(angle, tuple(np.eye(5)[axis] * size)) for size in sizes]
    names = tuple(trial_name(angle, loads) for angle, loads in rows)
    angles, loads = zip(*rows, strict=True)
    return Protocol(
        name="grid", trials=names, flexion_deg=np.array(angles), loads=np.array(loads, float)
    )


def as_a_rig_reads_it(protocol: Protocol) -> Protocol:
    """The same trials with an angle, stray forces and a compression of their own."""
    generator = np.random.default_rng(1)
    strays = np.zeros((protocol.n, 5))
    strays[:, 2:] = generator.normal(scale=STRAY_N, size=(protocol.n, 3))
    strays[:, 3] += COMPRESSION_N
    away = generator.uniform(-STRAY_DEG, STRAY_DEG, protocol.n)
    return replace(
        protocol,
        name="rig",
        flexion_deg=np.round(protocol.flexion_deg + away, 3),
        loads=np.round(protocol.loads + strays, 3),
    )


def table_of(knee: Knee, form: str) -> Laxity:
    """A table of a knee: measured where it comes with one and the form is that of a rig."""
    if form == FORMS[1] and knee.name.startswith("s192803"):
        return example_laxity(knee.name)
    protocol = grid() if form == FORMS[0] else as_a_rig_reads_it(grid())
    model = LaxityModel(knee=knee, protocol=protocol)
    whole = model.simulate(model.parameters.start)
    return add_noise(whole, sd_mm=0.5, sd_deg=0.5, seed=1)


def commands(knee: Knee, table: Path) -> Iterator[tuple[str, list[str]]]:
    """Short calls of all verbs that draw, by name; most parameters are held."""
    of_data, of_knee = [knee.name, str(table)], [knee.name, "--protocol", "drawer"]
    names = LaxityModel(knee=knee, protocol=grid()).parameters.names
    free = names[0]
    held = fixing(x for x in names if x != free)
    noise = ["--noise", NOISE]
    yield "simulate", ["simulate", *of_knee, *noise]
    yield "fit", ["fit", *of_data, *noise, "--budget", "20", "--more-starts", "1"]
    plausible = ["--plausible", "default", "--budget", "10", "--more-starts", "1"]
    yield "fit with limits", ["fit", *of_data, *noise, *held, *plausible]
    yield "sweep", ["sweep", *of_data, "--n-starts", "3", "--paths", "1"]
    yield "profile", ["profile", *of_data, *noise, *held, "--parameter", free]
    yield "sample", ["sample", *of_data, *noise, *held, "--ensembles", "2", "--budget", "300"]
    yield "information", ["information", *of_data, *noise, *held]
    yield "equivalents", ["equivalents", *of_data, *noise, *held, "--n-sets", "2"]
    yield "sobol", ["sensitivity", *of_knee, "--samples", "2"]
    yield "morris", ["sensitivity", *of_knee, "--method", "morris", "--samples", "2"]
    yield "diagnose", ["diagnose", *of_data, *noise]
    yield "isolability", ["diagnose", *of_knee, *noise]
    target = ["--n-trials", "1", "--target", free, "--candidates", "drawer"]
    yield "design", ["design", *of_data, *noise, *held, *target]


def found_in(knee: Knee, form: str, folder: Path) -> tuple[int, list[str], list[str]]:
    """How many figures there are, their faults, and verbs that refused."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "table.csv"
    if not table.exists():
        write_laxity(table_of(knee, form), table)
    n, wrong, refused = 0, [], []
    for name, words in commands(knee, table):
        out = folder / name.replace(" ", "_")
        if not (out / "result.json").exists():
            result = CliRunner().invoke(app, [*words, "--out", str(out)])
            if not (out / "result.json").exists():
                said = result.output.strip().splitlines()[-1:]
                refused.append(f"{knee.name}, {form}, {name}: {''.join(said)[:160]}")
                continue
        figures = faults_of(out)
        n += len(figures)
        wrong += [
            f"{knee.name}, {form}, {figure}: {fault}"
            for figure, own in figures.items()
            for fault in own
        ]
    return n, wrong, refused


def parts(_options: argparse.Namespace) -> Iterator[Row]:
    """The row with the figures of one more subject and form of a table at a time."""
    n, n_done, wrong, refused = 0, 0, list[str](), list[str]()
    for subject in NAMED_SUBJECTS:
        for k, form in enumerate(FORMS):
            folder = KEPT / f"{subject.name}-{k}"
            more, faults, without = found_in(ik.example(subject.name), form, folder)
            n, wrong, refused = n + more, wrong + faults, refused + without
            n_done += 1
            print(f"   {subject.name}, {form}: {more} figures, {len(faults)} faults", flush=True)
            yield _row(n, n_done, wrong, refused)


def _row(n: int, n_done: int, wrong: list[str], refused: list[str]) -> Row:
    n_all = len(NAMED_SUBJECTS) * len(FORMS)
    return Row(
        line="figures of all verbs, all named subjects and two forms of a measured table: none is "
        "empty, clipped, overlapping, twice, named as in code or in another colour than elsewhere",
        measures=[
            Measure(what="subjects and forms", value=n_done, unit="", bar=n_all, at_least=True),
            Measure(what="figures", value=n, unit="", bar=1, at_least=True),
            Measure(what="faults", value=len(wrong), unit="", bar=0),
        ],
        notes=[*wrong, *(f"no result: {x}" for x in refused)],
    )
