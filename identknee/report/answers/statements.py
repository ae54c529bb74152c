"""The statements of any answer."""

from importlib import import_module

from identknee.report.statement import Statement
from identknee.verbs.answer import Answer

# By the class of the answer. Loaded when asked for, so that no verb waits for all others.
_OF = {
    "Profiles": "profile:profile_statements",
    "Sweep": "sweep:sweep_statements",
    "Sample": "sample:sample_statements",
    "GlobalSensitivity": "sensitivity:sensitivity_statements",
    "LocalIdentifiability": "information:information_statements",
    "Equivalents": "equivalents:equivalents_statements",
    "Demonstration": "demo:demo_statements",
    "Simulation": "simulate:simulate_statements",
    "Calibration": "fit:fit_statements",
    "Diagnosis": "diagnose:diagnosis_statements",
    "Isolability": "isolability:isolability_statements",
    "Design": "design:design_statements",
    "SubjectFacts": "subject:subject_statements",
    "SubjectCheck": "subject:check_statements",
    "SettledSubject": "subject:settle_statements",
}


def statements_of(answer: Answer) -> tuple[Statement, ...]:
    """What an answer says, its main sentence first."""
    module, _, name = _OF[type(answer).__name__].partition(":")
    return tuple(getattr(import_module(f"identknee.report.answers.{module}"), name)(answer))
