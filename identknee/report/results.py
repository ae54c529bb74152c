"""The results in a folder, as the verbs left them, and their figures."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from identknee.laxity.protocol import Protocol
from identknee.report.presenter import Drawing, of_type, presenter_of
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.record import Record, record
from identknee.runs.schema import read_json
from identknee.runs.words import listed
from identknee.subject.folder import read_subject
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import AGAIN, SUMMARY, loaded
from identknee.verbs.fitted_knee import with_stated_uncertainty_of
from identknee.verbs.registry import verb_named, verbs, verbs_with_answer

if TYPE_CHECKING:
    from identknee.report.laxity_figures import LaxityCurves

DEPTH, COMPARE = 2, "compare"
REMEDY = (
    "Give the folder --out of identknee demo, fit, profile or diagnose, or one that holds such."
)


@declared
class Result:
    """What one verb left in its folder."""

    folder: Path = entry("Where it is")
    record: Record = entry("The call, its inputs, seed, versions and time")
    answer: Answer = entry("What the verb gave back")
    knee: Knee | None = entry(
        "The subject, for figures that need it; None where it is not known", default=None
    )

    @property
    def verb(self) -> str:
        """The verb that made it."""
        return self.record.verb

    @property
    def subject(self) -> str:
        """The subject as the call named it."""
        named = self.record.settings.get("subject") or getattr(self.answer, "subject", None)
        return str(named or "a knee")

    @property
    def subject_digest(self) -> str:
        """SHA-256 of the knee, which identifies the subject."""
        return str(self.record.inputs.get("subject", self.subject))

    @property
    def tables(self) -> tuple[str, ...]:
        """The laxity tables as the call named them."""
        named = self.record.settings.get("data") or ()
        return (named,) if isinstance(named, str) else tuple(map(str, named))

    @property
    def data_digest(self) -> str:
        """SHA-256 of the laxity table; empty for none."""
        return self.record.inputs.get("data") or ""

    @property
    def protocol(self) -> Protocol | None:
        """The trials; None where the result keeps none."""
        return presenter_of(self.answer).protocol(self.answer)


@declared
class Findings:
    """All results of one subject."""

    subject: str = entry("Name of the subject in the first call")
    results: tuple[Result, ...] = entry(
        "Results in the order of the flow, older ones first within a verb"
    )

    @property
    def title(self) -> str:
        """The subject's name; of a path its last part."""
        return self.subject.replace("\\", "/").rstrip("/").rpartition("/")[2] or self.subject

    def of(self, *verbs: str) -> tuple[Result, ...]:
        """The results of these verbs, in the order of the verbs given."""
        return tuple(x for verb in verbs for x in self.results if x.verb == verb)

    @property
    def of_main_data(self) -> tuple[Result, ...]:
        """The results of the table that most were made from; of equals the latest."""
        used = [x.data_digest for x in self.results if x.data_digest]
        latest = {x: k for k, x in enumerate(used)}
        main = max(used, key=lambda x: (used.count(x), latest[x]), default="")
        return tuple(x for x in self.results if x.data_digest == main)

    @property
    def merged(self) -> "Findings":
        """The findings with answers from one data set joined where their kind allows it."""
        kept: list[Result] = []
        for x in self.results:
            alike = [y for y in kept if (y.verb, y.data_digest) == (x.verb, x.data_digest)]
            for first in alike[:1]:
                joined = presenter_of(x.answer).joined(first.answer, x.answer)
                if joined is not None:
                    kept[kept.index(first)] = replace(first, answer=joined)
                    break
            else:
                kept.append(x)
        return replace(self, results=tuple(kept))


def found_results(folder: Path) -> tuple[Result, ...]:
    """All results in a folder and in the folders in it, in the order of the flow.

    Parameters
    ----------
    folder
        A folder ``--out`` of a verb, or one that holds such folders.

    Raises
    ------
    InputError
        If there is no such folder, no result in it, or one that cannot be read.
    """
    if not folder.exists():
        raise InputError(folder, "", "there is no such folder", REMEDY)
    if not folder.is_dir():
        raise InputError(folder, "", "this is a file, not a folder", REMEDY)
    places = sorted(
        path
        for depth in range(DEPTH + 1)
        for path in folder.glob("/".join(["*"] * depth + [SUMMARY]))
        if not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )
    found = [result for path in places if (result := _read(path)) is not None]
    if not found:
        raise InputError(folder, "", "there are no results in it", REMEDY)
    return in_order(found)


def in_order(results: Sequence[Result]) -> tuple[Result, ...]:
    """The results in the order of the flow, older ones first within a verb."""
    order = [x.name for x in verbs()]
    return tuple(sorted(results, key=lambda x: (order.index(x.verb), x.record.started)))


def by_subject(results: Sequence[Result]) -> tuple[Findings, ...]:
    """The results by their subject, in the order in which subjects first come."""
    results = [x for x in results if x.verb != COMPARE]
    digests = list(dict.fromkeys(x.subject_digest for x in results))
    return tuple(
        Findings(subject=own[0].subject, results=own)
        for digest in digests
        if (own := tuple(x for x in results if x.subject_digest == digest))
    )


def comparisons(results: Sequence[Result]) -> tuple[Result, ...]:
    """Those of the results that set others side by side; they are of no one subject."""
    return tuple(x for x in results if x.verb == COMPARE)


def _read(path: Path) -> Result | None:
    """The result at `path`; None where it is of a verb with nothing to report."""
    summary = read_json(path, AGAIN)
    made = summary.get("record") if isinstance(summary, dict) else None
    verb = verb_named(made.get("verb")) if isinstance(made, dict) else None
    if verb is None or not verb.is_reported:
        return None
    return result_of(loaded(path, summary, verb.answer_class), path.parent)


def result_of(answer: Answer, folder: Path | None = None) -> Result:
    """The answer as the report takes it, as if it had been read from a folder."""
    made = (
        answer.record
        or record(next(verbs_with_answer(type(answer).__name__)).name, {}, {}).finish()
    )
    return Result(folder=folder or Path(made.verb), record=made, answer=answer)


def knee_of(findings: Findings, remarks: list[str], knee: Knee | None = None) -> Knee | None:
    """The subject as it was when the results were made; without it a remark says why."""
    name = findings.subject
    try:
        knee = knee or read_subject(name)
    except ValueError as error:
        remarks.append(f"The knee itself is not shown: {error}")
        return None
    try:
        return with_stated_uncertainty_of(knee, findings.results[0].answer)
    except ValueError:
        remarks.append(f"The knee itself is not shown: {name} has changed since.")
        return None


def drawings(result: Result) -> tuple[Drawing, ...]:
    """All figures of a result, the most informative first; none where the answer is a table."""
    shows = presenter_of(result.answer)
    return tuple(shows.drawings(result.answer, result.subject, result.knee))


def laxity_drawings(findings: Findings) -> Iterator[tuple[Result, Drawing]]:
    """Laxity curves of the results that compare a model with data, or else of simulations."""
    fits = findings.of("fit")
    # Without causes the model of a diagnosis is that of the fits.
    diagnoses = [
        x
        for x in findings.of("diagnose")
        if not fits or any(y.causes for y in of_type([x.answer], Diagnosis))
    ]
    first_fits = {x.data_digest: x for x in reversed(fits)}
    compared = [*first_fits.values(), *diagnoses] or findings.of("demo", "simulate")
    for result in compared:
        beside = [x.answer for x in findings.results if x.data_digest == result.data_digest]
        curves = presenter_of(result.answer).curves(result.answer, beside)
        if curves is not None:
            yield from ((result, x) for x in _drawings_of_curves(curves))


def _drawings_of_curves(curves: "LaxityCurves") -> Iterator[Drawing]:
    """Laxity along load curves, and by load and flexion where trials make up none."""
    from identknee.report.laxity_figures import (
        all_coordinates_figure,
        along_load_figure,
        by_load_figure,
    )

    measured, drawn = curves.measured is not None, listed(curves.simulated)
    sources = listed([*curves.simulated, *["data"] * measured])
    bars = " with two standard deviations" * (curves.sd is not None)
    parts = [f"dots: measured{bars}"] * measured + [f"lines: {drawn}"]
    if curves.band is not None:
        parts.append(f"band: {curves.band[0]}")
    on_curves, others = curves.parts()
    for number, (title, other) in enumerate(others.items(), start=1):
        yield Drawing(
            name="laxity" if number == 1 else f"laxity-{number}",
            figure=by_load_figure(other, title),
            caption=f"Where the tibia lies under each load, both directions in one panel; "
            f"{'; '.join(parts)}. Tinted ground: the coordinate along the load.",
            description=f"All coordinates under every load against flexion: {sources}.",
        )
    if on_curves is None or (along := along_load_figure(on_curves)) is None:
        return
    yield Drawing(
        name="laxity-curves" if others else "laxity",
        figure=along,
        caption=f"Displacement along each load; {'; '.join(parts)}.",
        description=f"Laxity along every load at each flexion angle: {sources}.",
    )
    if (whole := all_coordinates_figure(on_curves)) is not None:
        yield Drawing(
            name="laxity-all",
            figure=whole,
            caption="All five coordinates along every load, also those it does not act on "
            "directly.",
            description=f"Five coordinates along every load: {sources}.",
        )
