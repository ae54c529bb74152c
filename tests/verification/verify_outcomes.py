"""How trials end anywhere in the parameter box, and whether those given up have an equilibrium."""

import argparse
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from knees import SCALE, anywhere, model, trial_energy
from requirement_rows import Measure, Row, largest_of
from slow_path import follow_slowly

from identknee.checks.subject_checks import box_sample
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

VECTORS = 10_000
NEAR_VECTORS = 2_000
LEAST_CONVERGED = 99.0  # % within k +-50 %, eps +-3 of the reference knee
GIVEN_UP = 200
# Converged trials solved again the slow way: nearly all must come out at the same pose, or that way
# could not judge the trials given up. The others crossed a snap shorter than the model looks for.
CONTROLS = 200
LEAST_CONTROLLED = 95.0  # %
LARGEST_CONTROL_CHANGE = 1e-4  # mm, angles times 40 mm
MOST_WITH_EQUILIBRIUM = 1.0  # % of them
# A trial that left the geometry has an equilibrium, in a place where the surfaces say nothing.
WITHOUT = (Outcome.FOLD, Outcome.NO_EQUILIBRIUM, Outcome.UNCONSTRAINED)
SLOWEST = 10.0  # s; a prediction that takes longer hangs


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A trial at a parameter vector."""

    of: LaxityModel
    theta: Array
    trial: int
    outcome: Outcome
    pose: Array

    @property
    def described(self) -> str:
        """What it takes to simulate it again."""
        values = np.array2string(self.theta, precision=17, separator=", ", max_line_width=10_000)
        return f"{self.of.knee.name}, {self.of.protocol.trials[self.trial]}, theta {values}"


@dataclass
class Tally:
    """What many vectors came to."""

    counts: Counter[str] = field(default_factory=Counter)
    n_nan: int = 0
    n_raised: int = 0
    slowest: float = 0.0
    seconds: float = 0.0
    given_up: list[Place] = field(default_factory=list)
    converged: list[Place] = field(default_factory=list)


def measure(options: argparse.Namespace) -> Row:
    """Ten thousand vectors on each of three knees, then the trials given up, solved again."""
    measures: list[Measure] = []
    notes: list[str] = []
    given_up: list[Place] = []
    converged: list[Place] = []
    for number, name in enumerate(("reference", "lenhart2015_stable", "lenhart2015")):
        subject = model(name)
        generator = np.random.default_rng([10, number])
        tally = tally_of(subject, anywhere(subject.parameters, VECTORS, generator))
        measures += _judged(name, tally, VECTORS)
        notes.append(_described(name, tally, subject.protocol.n * VECTORS))
        print(notes[-1], flush=True)
        given_up += tally.given_up
        converged += tally.converged
    subject = model("reference")
    near = box_sample(subject.parameters, NEAR_VECTORS, np.random.default_rng(11))
    tally = tally_of(subject, near)
    share = 100.0 * tally.counts[Outcome.CONVERGED.value] / tally.counts.total()
    measures.append(
        Measure(
            what="reference, k +-50 %, eps +-3: trials converged",
            value=share,
            unit="%",
            bar=LEAST_CONVERGED,
            at_least=True,
            count=tally.counts.total(),
        )
    )
    notes.append(_described("reference, near", tally, tally.counts.total()))
    print(notes[-1], flush=True)
    folds = [x for x in given_up if x.outcome is not Outcome.UNCONSTRAINED]
    for what, places in (("given-up trials", given_up), ("of them folds", folds)):
        more, note = _solved_again(what, places)
        measures.append(more)
        notes += note
    controls, elsewhere = _controlled(converged)
    measures += controls
    notes += elsewhere
    return Row(
        line="10,000 parameter vectors from k in [0, 40] kN, eps_r in [-15, 15] % on three knees: "
        "all end converged or with a named outcome, none hang, none give NaN; of 200 random "
        "non-converged trials re-solved with 0.1 N m steps and an independent minimiser <= 1 % "
        "have an equilibrium on the followed branch; reference within k +-50 %, eps +-3: >= 99 % "
        "converged",
        measures=measures,
        notes=notes,
    )


def tally_of(of: LaxityModel, vectors: Array) -> Tally:
    """How the trials of every vector end."""
    tally = Tally()
    for index, theta in enumerate(vectors):
        began = time.perf_counter()
        try:
            prediction = of.predict(theta)
        except Exception:  # noqa: BLE001 - whatever it raises is what is counted
            tally.n_raised += 1
            continue
        seconds = time.perf_counter() - began
        tally.seconds += seconds
        tally.slowest = max(tally.slowest, seconds)
        tally.counts.update(outcome.value for outcome in prediction.outcomes)
        tally.n_nan += not _is_finite(prediction)
        for trial, outcome in enumerate(prediction.outcomes):
            place = Place(
                of=of, theta=theta, trial=trial, outcome=outcome, pose=prediction.poses[trial]
            )
            if outcome in WITHOUT:
                tally.given_up.append(place)
            elif outcome is Outcome.CONVERGED and trial == index % of.protocol.n:
                tally.converged.append(place)
    return tally


def _is_finite(prediction: Prediction) -> bool:
    """Whether all is finite that should be: poses of all trials, the rest where converged."""
    if prediction.jacobian is None or prediction.hessians is None:
        raise AssertionError
    converged = prediction.is_converged
    return bool(
        np.isfinite(prediction.poses).all()
        and np.isfinite(prediction.hessians).all()
        and np.isfinite(prediction.coordinates[converged]).all()
        and np.isfinite(prediction.jacobian[converged]).all()
    )


def _judged(name: str, tally: Tally, n: int) -> list[Measure]:
    return [
        Measure(what=f"{name}, vectors with NaN", value=tally.n_nan, unit="", bar=0, count=n),
        Measure(what=f"{name}, exceptions", value=tally.n_raised, unit="", bar=0, count=n),
        Measure(what=f"{name}, slowest", value=tally.slowest, unit="s", bar=SLOWEST, count=n),
    ]


def _described(name: str, tally: Tally, n: int) -> str:
    counts = ", ".join(
        f"{outcome} {count:,} ({100 * count / n:.2f} %)"
        for outcome, count in tally.counts.most_common()
    )
    return f"{name}: {counts}; {tally.seconds:.0f} s"


def _solved_again(what: str, places: list[Place]) -> tuple[Measure, list[str]]:
    ends, found = [], []
    for index in np.random.default_rng(12).choice(len(places), GIVEN_UP, replace=False):
        place = places[index]
        ends.append(follow_slowly(trial_energy(place.of, place.theta, place.trial)))
        if ends[-1].place is not None:
            found.append(place.described)
    reasons = Counter(end.reason for end in ends)
    loaded = sum(end.reached >= 1.0 for end in ends)
    note = f"{what}: {len(ends)} of {len(places):,} solved again: " + ", ".join(
        f"{reason} {count}" for reason, count in reasons.most_common()
    )
    notes = [f"{note}; {loaded} ended under load, the rest on the way to their flexion"]
    notes += [f"{what}, with an equilibrium: {place}" for place in found]
    measure = Measure(
        what=f"{what} with an equilibrium on the followed branch",
        value=100.0 * len(found) / len(ends),
        unit="%",
        bar=MOST_WITH_EQUILIBRIUM,
        count=len(ends),
    )
    return measure, notes


def _controlled(places: list[Place]) -> tuple[list[Measure], list[str]]:
    """Whether the slow way finds what is there: converged trials solved again by it."""
    changes, other = [], []
    for index in np.random.default_rng(13).choice(len(places), CONTROLS, replace=False):
        place = places[index]
        end = follow_slowly(trial_energy(place.of, place.theta, place.trial))
        change = np.inf
        if end.place is not None:
            change = float(np.linalg.norm(end.place - place.pose * SCALE))
        if change <= LARGEST_CONTROL_CHANGE:
            changes.append(change)
        else:
            other.append(
                f"control that ended elsewhere ({end.reason} by {end.jump:.2f} mm, "
                f"{end.reached:.4f} of 2 legs): {place.described}"
            )
    share = Measure(
        what="control: converged trials that the slow way finds at the same pose",
        value=100.0 * len(changes) / CONTROLS,
        unit="%",
        bar=LEAST_CONTROLLED,
        at_least=True,
        count=CONTROLS,
    )
    what = "control: change of those poses"
    return [share, largest_of(what, changes, "mm, angles times 40 mm")], other
