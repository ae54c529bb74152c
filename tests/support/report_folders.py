"""Folders of results as verbs leave them, made from the library in seconds."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from diagnoses import FRAME, answered
from problems import linear

from identknee.calibrate.problem import with_bounds
from identknee.identify.profile.profile import profile_parameters
from identknee.identify.profile.result import Profile
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.runs.files import write_json
from identknee.runs.record import record
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.files import write_answer
from identknee.verbs.fit import fit
from identknee.verbs.profile import Profiles
from identknee.verbs.simulate import simulate

KNEE = "0" * 64
OPEN_BELOW = "x0.value_pct"


def write_verb(
    folder: Path, verb: str, summary: dict[str, Any], *, subject: str = "reference"
) -> Path:
    """A folder with the summary that a verb leaves."""
    folder.mkdir(parents=True, exist_ok=True)
    made = record(verb, {"subject": subject}, {"subject": KNEE}, 0).finish()
    write_json(folder / "result.json", {**summary, "record": made.to_dict()})
    return folder


def write_given(
    folder: Path,
    verb: str,
    answer: Answer,
    *,
    subject: str = "reference",
    digest: str = KNEE,
) -> Path:
    """A folder with what a verb that gave this answer leaves."""
    folder.mkdir(parents=True, exist_ok=True)
    settings = {"subject": subject, "data": "test/laxity.csv"}
    inputs = {"subject": digest, "data": "d" * 64}
    write_answer(folder, replace(answer, record=record(verb, settings, inputs, 0).finish()))
    return folder


def some_profiles() -> tuple[Profile, ...]:
    """A closed one, and one with an open end."""
    problem = linear()
    cut = with_bounds(problem, {OPEN_BELOW: (problem.minimum[0] - 0.1, 10.0)})
    (open_one,) = profile_parameters(cut, problem.minimum, [OPEN_BELOW])
    (closed,) = profile_parameters(problem, problem.minimum, ["x1.value_pct"])
    return open_one, closed


def profile_folder(folder: Path, **named: str) -> Path:
    """What `identknee profile` leaves of a straight problem."""
    return write_given(folder, "profile", straight_profiles(), **named)


def straight_profiles() -> Profiles:
    """The answer of `profile` to a straight problem."""
    profiles = some_profiles()
    problem = linear()
    return Profiles(
        parameters={x.name: x for x in profiles},
        quantities={},
        pairs=(),
        parameter_names=problem.parameters.names,
        optimum=problem.minimum,
        deviance=profiles[0].deviance,
        degrees_of_freedom=None,
    )


def few_trials() -> Protocol:
    """Three moments of each kind at one angle."""
    whole = load_protocol("seed63")
    sizes = np.abs(whole.loads).max(axis=1)
    chosen = np.isin(sizes, (0.0, 8.0)) & (whole.flexion_deg == 30.0)
    return whole.select(np.flatnonzero(chosen))


def fit_folder(folder: Path, knee: Knee, **named: str) -> Path:
    """What `identknee fit` leaves of a knee under a few trials, fitted to its own noisy laxity."""
    laxity = simulate(knee, few_trials(), noise="0.3mm,0.3deg", seed=1).noisy
    assert laxity is not None
    return write_given(folder, "fit", fit(knee, laxity, budget=3), **named)


def diagnosis_folder(folder: Path, **named: str) -> Path:
    """What `identknee diagnose` leaves of data with an effect in them."""
    return write_given(folder, "diagnose", answered(FRAME), **named)
