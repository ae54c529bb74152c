"""The tests to do next, from every result that advises some."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from identknee.laxity.trial_words import trial_words
from identknee.model.effects.facts import cause_label
from identknee.report.words import counted, interval_words
from identknee.runs.plain_records import summary_of
from identknee.runs.words import capital, listed, parameter_words, unit_of
from identknee.verbs.answer import Answer
from identknee.verbs.design import Design
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.isolability import Isolability


def next_tests(answers: Sequence[Answer]) -> tuple[str, ...]:
    """A sentence a purpose: the trials, and what they would bring."""
    return tuple(said for answer in answers for said in _advice(answer))


def _advice(answer: Answer) -> Iterator[str]:
    if isinstance(answer, Design):
        choice = answer.choice
        name = choice.targets[0]
        before, after = choice.before[name], choice.after[name]
        now, then = (interval_words(x.lower, x.upper, unit_of(name)) for x in (before, after))
        words = parameter_words(name)
        brings = f"This would narrow {words} to {then}; it is {now} now."
        if now == then:
            brings = f"{capital(words)} stays {then}."
        yield f"{_trials(answer.trials)}. {brings}"
    elif isinstance(answer, Diagnosis) and answer.advised_trials:
        said = "" if answer.advice is None else f" {answer.advice.sentence}"
        yield f"{_trials([summary_of(x) for x in answer.advised_trials])}.{said}"
    elif isinstance(answer, Isolability):
        for group in answer.groups:
            if group.advised_trials:
                trials = _trials([summary_of(x) for x in group.advised_trials])
                causes = listed(map(cause_label, group.effects), "from")
                yield f"{trials}. This would tell {causes}."


def _trials(trials: Sequence[Mapping[str, Any]]) -> str:
    return capital(counted(map(trial_words, trials)))
