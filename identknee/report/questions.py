"""Answers side by side: which a later search has put out of date, which were asked otherwise."""

from collections.abc import Iterator, Sequence

from identknee.checks.fit_checks import SAME
from identknee.runs.words import listed
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration
from identknee.verbs.question import Question


def stale_answers(answers: Sequence[Answer]) -> dict[int, Answer]:
    """Places of answers at a best fit that another one undercuts, with the lowest such other.

    Both were asked the same question. Fits alone from several starts are compared elsewhere.
    """
    found = {}
    for place, own in enumerate(answers):
        others = [
            x
            for x in answers
            if x.best_deviance < own.best_deviance - SAME
            and not (isinstance(x, Calibration) and isinstance(own, Calibration))
            and _differences(own.question, x.question) == ()
        ]
        if others:
            found[place] = min(others, key=lambda x: x.best_deviance)
    return found


def question_sentences(answers: Sequence[Answer]) -> Iterator[str]:
    """Which answers are out of date, and in what the questions of the others differ."""
    for place, better in stale_answers(answers).items():
        own = answers[place]
        yield (
            f"{_verb(own).capitalize()} rests on a fit of deviance {own.best_deviance:.4g}, and "
            f"{_verb(better)} found one of {better.best_deviance:.4g}: {_verb(own)} is out of "
            "date and should be run again."
        )
    asked = [x for x in answers if x.question is not None]
    if len(asked) < 2:
        return
    groups: dict[tuple[str, ...], list[str]] = {}
    first = asked[0]
    for x in asked[1:]:
        if differences := _differences(first.question, x.question):
            groups.setdefault(differences, []).append(_verb(x))
    for differences, verbs in groups.items():
        yield (
            f"{listed(dict.fromkeys(verbs)).capitalize()} and {_verb(first)} were asked different "
            f"questions: they differ in {listed(differences)}."
        )


def _differences(one: Question | None, other: Question | None) -> tuple[str, ...] | None:
    """In what two questions differ; None where one is not known."""
    return None if one is None or other is None else one.differences(other)


def _verb(answer: Answer) -> str:
    return "a fit" if answer.record is None else answer.record.verb
