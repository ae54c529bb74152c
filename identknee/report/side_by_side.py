"""Results side by side: of one knee, of several, of several models, before and after a change."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Unpack

from identknee.report.comparison import Comparison, comparison
from identknee.report.results import Result, found_results, result_of
from identknee.runs.files import PathLike
from identknee.verbs.answer import Answer
from identknee.verbs.options import OutOption, argument, option
from identknee.verbs.verb import Run, verb

ResultsLike = Sequence[Answer | PathLike] | Mapping[str, Answer | PathLike]


@verb
def compare(
    run: Run,
    results: Annotated[
        ResultsLike,
        argument(
            "Results folders of any commands, or folders of such folders of one knee each.",
            "DIR...",
            in_python="Answers, folders, or either by name in a dictionary.",
            typed=list[Path],
        ),
    ],
    *,
    names: Annotated[
        Sequence[str] | None,
        option(
            "Name of each folder in tables and figures, in their order. If not given: the folders' "
            "own.",
            "--name",
            in_python="A list.",
            metavar="NAME",
        ),
    ] = None,
    **_: Unpack[OutOption],
) -> Comparison:
    """Results side by side: parameters, forces, misfit, and in what the questions differ.

    The results may be of one knee, of several, of several models, or before and after an
    extension. Each folder gives its most informative method for a quantity, the same one for all
    where they share one. Misfit and evidence are compared only where the data and the noise are
    the same.

    Raises
    ------
    ValueError
        If there are fewer than two results, names do not fit them, or one folder has several
        knees.
    InputError
        If a folder holds no results.
    """
    given = _named(results, names)
    run.start_clock()
    return comparison(given)


def _named(results: ResultsLike, names: Sequence[str] | None) -> dict[str, tuple[Result, ...]]:
    """The results of each answer or folder by its name."""
    if isinstance(results, Mapping):
        names, results = names or list(results), list(results.values())
    if isinstance(results, Answer | str | os.PathLike) or len(results) < 2:
        raise ValueError("a comparison needs two results or more; give their folders or answers")
    found = [_results_of(x) for x in results]
    names = list(names or _own_names(found, results))
    if len(names) != len(found):
        raise ValueError(f"--name: {len(names)} names for {len(found)} results; give one for each")
    if repeated := [x for x in names if names.count(x) > 1]:
        raise ValueError(f"--name {repeated[0]} is given twice; give each result its own name")
    return dict(zip(names, found, strict=True))


def _results_of(given: Answer | PathLike) -> tuple[Result, ...]:
    """The results of one answer, or of a folder with one knee."""
    if isinstance(given, Answer):
        return (result_of(given),)
    found = tuple(x for x in found_results(Path(given)) if not isinstance(x.answer, Comparison))
    if len({x.subject_digest for x in found}) != 1 or len({x.data_digest for x in found}) > 1:
        raise ValueError(
            f"{given} holds results of several knees or tables; give their folders one by one"
        )
    return found


def _own_names(found: Sequence[Sequence[Result]], given: Sequence[Any]) -> list[str]:
    """Names of the folders; numbers tell apart those of one name."""
    plain = [
        own[0].verb if isinstance(x, Answer) else Path(x).resolve().name
        for own, x in zip(found, given, strict=True)
    ]
    return [
        x if plain.count(x) == 1 else f"{x} {plain[: k + 1].count(x)}" for k, x in enumerate(plain)
    ]
