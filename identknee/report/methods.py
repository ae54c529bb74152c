"""A paragraph on methods for a paper, from the record of an answer and nothing else."""

import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from identknee.report.presenter import presenter_of
from identknee.runs.record import Record
from identknee.runs.words import listed, parameter_words
from identknee.verbs.answer import Answer, Question
from identknee.verbs.registry import verb_named

DIGITS = 12  # of a digest
# Options that change no number, or that the sentence names as its subject and data.
UNSAID = frozenset({"subject", "data", "results", "out", "workers"})
MOST_TRIALS = 4
SOFTWARE = (
    "identknee: how far can a knee ligament calibration be trusted? The identknee developers, "
    "version {version}"
)
PAPER = "Theodorakos and Andersen (2024), Bioengineering 11(12), 1183, "
PAPER += "doi:10.3390/bioengineering11121183"


def methods_text(answer: Answer) -> str:
    """The paragraph, then the call and the references on lines of their own.

    Raises
    ------
    ValueError
        If the answer has no record, as one that no verb gave back.
    """
    record = answer.record
    if record is None:
        raise ValueError("only what a verb gave back knows how it was made; this has no record")
    shows = presenter_of(answer)
    sentences = [
        *_program(record),
        *_data(answer, record),
        *shows.method(answer),
        *_question(answer.question, record),
        *_uncertainty(answer),
        *(
            [f"The seed of all random numbers was {record.seed}."]
            if record.seed is not None
            else ()
        ),
    ]
    version = record.versions.get("identknee", "")
    references = [*shows.sources(answer), SOFTWARE.format(version=version), PAPER]
    parts = (" ".join(sentences), f"Call: {_call(record)}", f"References: {'; '.join(references)}.")
    return "\n\n".join(parts)


def _program(record: Record) -> Iterator[str]:
    versions = dict(record.versions)
    own = versions.pop("identknee", "")
    others = ", ".join(f"{name} {x}" for name, x in versions.items())
    beside = f" with {others}" if others else ""
    yield f"The command {record.verb} of identknee {own} was used{beside}.".replace("  ", " ")


def _data(answer: Answer, record: Record) -> Iterator[str]:
    """Subject, tables and trials, with the digests by which they are known."""
    inputs, settings = record.inputs, record.settings
    if subject := settings.get("subject"):
        known = f" (SHA-256 {inputs['subject'][:DIGITS]})" if "subject" in inputs else ""
        yield f"The knee was {_last_part(subject)}{known}."
    asked = answer.question
    if "data" in inputs and settings.get("data"):
        given = settings["data"]
        tables = [given] if isinstance(given, str) else given
        what = f"{listed(map(_last_part, tables))} (SHA-256 {inputs['data'][:DIGITS]})"
        n = "" if asked is None else f"{len(asked.trials)} trials with measured values from "
        yield f"The data were {n}{what}."
    if asked is not None:
        for names, why in (
            (asked.left_out_by_name, "by choice"),
            (asked.contradicted, "because the rest of the table contradicts them"),
        ):
            if names:
                shown = f": {listed(names)}" if len(names) <= MOST_TRIALS else ""
                trials = "1 trial was" if len(names) == 1 else f"{len(names)} trials were"
                yield f"{trials} left out {why}{shown}."


def _question(asked: Question | None, record: Record) -> Iterator[str]:
    """Noise, priors, bounds and what was held."""
    if asked is None:
        return
    if asked.weighting == "noise":
        sizes = [
            f"{size:g} {unit}"
            for size, unit in ((asked.noise_mm, "mm"), (asked.noise_deg, "deg"))
            if size is not None
        ]
        median = "" if record.settings.get("noise") else " (the medians of those in the data)"
        stated = f" of {listed(sizes)}{median}" if sizes else ""
        yield f"Residuals were divided by standard deviations of the noise{stated}."
    elif asked.weighting == "estimated":
        yield "The noise was not stated; it was estimated from the fit."
    elif asked.weighting == "unit":
        yield "Residuals of 1 mm and of 1 deg counted alike."
    if asked.priors:
        yield "Priors of the ligament parameters were part of the objective."
    else:
        yield "Ligament parameters had bounds and no priors."
    if asked.fixed:
        yield f"Held at the start were {listed(map(parameter_words, asked.fixed))}."
    if asked.bounds:
        ends = (f"{parameter_words(x)} ({a:g} to {b:g})" for x, (a, b) in asked.bounds.items())
        yield f"Bounds were stated for {listed(ends)}."
    if asked.plausibility:
        yield f"Limits of plausibility counted as evidence: {listed(asked.plausibility)}."


def _uncertainty(answer: Answer) -> Iterator[str]:
    """What of knee and tests was taken as uncertain."""
    if not answer.uncertainty:
        return
    stated = [
        f"{name.rpartition('_')[0].replace('_', ' ') or name} ({x})"
        if name.endswith(("_mm", "_deg"))
        else f"{name.replace('_', ' ')} ({x})"
        for name, x in answer.uncertainty.items()
        if x != "exact"
    ]
    if stated:
        yield f"Taken as uncertain, with these standard deviations, were {listed(stated)}."
    else:
        yield "Geometry, frames, loads and flexion of the tests were taken as exact."


def _call(record: Record) -> str:
    """The call with all options that are not as they are by default."""
    words = ["identknee", *record.verb.split()]
    for name in ("subject", "data", "results"):
        given = record.settings.get(name)
        listed_words = [given] if isinstance(given, str) else given or []
        words += [_last_part(x) for x in listed_words]
    for flag, value in given_options(record).items():
        if isinstance(value, bool):
            words.append(flag if value else f"--no-{flag.removeprefix('--')}")
        else:
            given = _last_part(value) if isinstance(value, str) else value
            words += [y for x in _texts(given) for y in (flag, x)]
    return shlex.join(words)


def given_options(record: Record) -> dict[str, Any]:
    """The settings of a call that are not as they are by default, by their options."""
    # It loads the module of the verb.
    from identknee.verbs.options import option_of, parameters_in_full

    verb = verb_named(record.verb)
    if verb is None:
        return {}
    known = parameters_in_full(verb.call)
    found = {}
    for name, value in record.settings.items():
        if name in UNSAID or name not in known:
            continue
        default = known[name].default
        is_default = value == default or (not value and not default)
        if not is_default or (name == "seed" and value is not None):
            flag = option_of(known[name].annotation).flag
            found[flag or f"--{name.replace('_', '-')}"] = value
    return found


def value_words(value: Any) -> str:
    """What an option was given, as one writes it.

    Examples
    --------
    >>> value_words(["ACL.stiffness_kN", ("a", "b")]), value_words({"cut": 5.0}), value_words(3)
    ('ACL.stiffness_kN, a:b', 'cut=5.0', '3')
    """
    return ", ".join(_texts(value))


def _texts(value: Any) -> list[str]:
    """What an option was given, one by one."""
    if isinstance(value, Mapping):
        return [f"{name}={_plain(x)}" for name, x in value.items()]
    if isinstance(value, str) or not isinstance(value, Sequence):
        return [str(value)]
    return [*map(_plain, value)]


def _plain(value: Any) -> str:
    return ":".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _last_part(path: Any) -> str:
    """The name of a file without its folder, which says nothing elsewhere."""
    word = str(path)
    return word.replace("\\", "/").rstrip("/").rpartition("/")[2] if os.sep in word else word
