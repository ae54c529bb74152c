"""The statements of any answer."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from identknee.report.answers.demo import demo_statements
from identknee.report.answers.design import design_statements
from identknee.report.answers.diagnose import diagnosis_statements
from identknee.report.answers.equivalents import equivalents_statements
from identknee.report.answers.fit import fit_statements
from identknee.report.answers.information import information_statements
from identknee.report.answers.isolability import isolability_statements
from identknee.report.answers.profile import profile_statements
from identknee.report.answers.sample import sample_statements
from identknee.report.answers.sensitivity import sensitivity_statements
from identknee.report.answers.simulate import simulate_statements
from identknee.report.answers.subject import (
    check_statements,
    settle_statements,
    subject_statements,
)
from identknee.report.answers.sweep import sweep_statements
from identknee.report.statement import Statement
from identknee.verbs.answer import Answer
from identknee.verbs.demo import Demonstration
from identknee.verbs.design import Design
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.equivalents import Equivalents
from identknee.verbs.fit import Calibration
from identknee.verbs.information import LocalIdentifiability
from identknee.verbs.isolability import Isolability
from identknee.verbs.profile import Profiles
from identknee.verbs.sample import Sample
from identknee.verbs.sensitivity import GlobalSensitivity
from identknee.verbs.simulate import Simulation
from identknee.verbs.subject_check import SubjectCheck
from identknee.verbs.subject_facts import SubjectFacts
from identknee.verbs.subject_settle import SettledSubject
from identknee.verbs.sweep import Sweep

_OF: Mapping[type[Answer], Callable[[Any], Iterator[Statement]]] = {
    Profiles: profile_statements,
    Sweep: sweep_statements,
    Sample: sample_statements,
    GlobalSensitivity: sensitivity_statements,
    LocalIdentifiability: information_statements,
    Equivalents: equivalents_statements,
    Demonstration: demo_statements,
    Simulation: simulate_statements,
    Calibration: fit_statements,
    Diagnosis: diagnosis_statements,
    Isolability: isolability_statements,
    Design: design_statements,
    SubjectFacts: subject_statements,
    SubjectCheck: check_statements,
    SettledSubject: settle_statements,
}


def statements_of(answer: Answer) -> tuple[Statement, ...]:
    """What an answer says, its main sentence first."""
    return tuple(_OF[type(answer)](answer))
