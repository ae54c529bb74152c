"""The page: one HTML file with the answer first and everything behind it after that."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from markupsafe import Markup

from identknee.diagnosis.verdict import Verdict
from identknee.report.answers.fit import nuisance_tables, parameters_at_bounds
from identknee.report.comparison import Comparison, comparison
from identknee.report.opening import MOST_FINDINGS, brief_line, command_on_data
from identknee.report.overview import (
    KNOWN,
    Overview,
    Row,
    Tone,
    fits_by_start,
    has_better_fit,
    overview,
)
from identknee.report.page.load_figures import KNEE_LOADS, load_drawings
from identknee.report.page.markup import document, parts
from identknee.report.page.svg import inline_svg, least_width
from identknee.report.page.viewer import KneeScene, viewer_html
from identknee.report.presenter import (
    Drawing,
    Question,
    Statement,
    Table,
    assumption_sentences,
    main_statements,
    of_type,
    presenter_of,
    statements_of,
    table,
)
from identknee.report.results import (
    Findings,
    Result,
    by_subject,
    comparisons,
    drawings,
    laxity_drawings,
    result_of,
)
from identknee.report.table_files import ESTIMATES, estimates_table, file_word, named, notes_of
from identknee.runs.declare import declared, entry
from identknee.runs.files import plain
from identknee.runs.findings import About, Finding, Severity, by_severity
from identknee.runs.progress import progress
from identknee.runs.record import Outcome, versions
from identknee.runs.schema import summary_of
from identknee.runs.words import capitalised, label, listed
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.fit import Calibration
from identknee.verbs.registry import verbs

# What is asked after a fit, in this order, before anything else.
AFTER_FIT = ("profile", "diagnose", "design")
# Rows of the table that are not folded: with a picture beside them they take one screen.
MOST_ROWS = 14
# Rows of a table of fitted parameters that is not one click away.
MOST_FITTED = 30


@declared
class Lead:
    """The first screens of a page, and what they leave for below."""

    found: Overview = entry("What all results say together")
    shown: tuple[str, ...] = entry("The most severe findings, each on a line or two")
    left: str = entry("How many more findings there are, in words; empty for none")
    below: tuple[str, ...] = entry("Findings in full that the first screens leave out or cut short")
    rows: tuple[Row, ...] = entry("The table")
    folded: tuple[Row, ...] = entry("Its rows that are one click away")
    ranges: Table = entry("What each method says where they differ")
    picture: Markup = entry("Measured and simulated laxity; empty where there is none")
    fitted: tuple[Table, ...] = entry("Parameters of the one fit, where no other verb says them")
    step: tuple[str, str] | None = entry(
        "A question that is open and its command, where no other step is advised"
    )


def lead_of(
    found: Overview,
    cautions: Sequence[Finding],
    picture: Markup,
    fitted: Sequence[Table],
    further: Sequence[tuple[str, str]],
) -> Lead:
    """The first screens of a page.

    Parameters
    ----------
    found
        What all results say together.
    cautions
        Findings that the sentences before the verdict do not say, the most severe first.
    picture
        Measured and simulated laxity; empty where there is none.
    fitted
        The parameters of fits.
    further
        Questions that no result answers with their commands.
    """
    opening = found.opening
    # Sentences before the verdict are findings too.
    n_shown = max(1, MOST_FINDINGS - opening.n_brief)
    shown = tuple(map(brief_line, cautions[:n_shown]))
    full = [x for x in opening.sentences if x not in opening.brief]
    below = [*full, *(x.line for x in cautions if x.line not in shown)]
    n_opening = len({x.identity for x in opening.findings}) - opening.n_brief
    is_advised = opening.has_command or found.next_tests
    return Lead(
        found=found,
        shown=shown,
        left=_left(n_opening, cautions[n_shown:], is_cut=bool(below)),
        below=tuple(below),
        rows=found.rows[:MOST_ROWS],
        folded=found.rows[MOST_ROWS:],
        ranges=table(
            "What each method says",
            ("quantity", "methods"),
            ((x.label, x.agreement) for x in found.rows if x.agreement != x.found.brief()),
        ),
        picture=picture,
        fitted=() if found.rows else tuple(x for x in fitted if len(x.rows) <= MOST_FITTED),
        step=None if is_advised else _step(found, further),
    )


def _step(found: Overview, further: Sequence[tuple[str, str]]) -> tuple[str, str] | None:
    """The question to ask next, with its command; None where all are answered."""
    by_verb = {command.split()[1]: (question, command) for question, command in further}
    is_fitted = found.rows or found.searches
    wanted = [*(AFTER_FIT if is_fitted else ()), *by_verb]
    return next((by_verb[x] for x in wanted if x in by_verb), None)


def _left(n_opening: int, cautions: Sequence[Finding], *, is_cut: bool) -> str:
    n = max(n_opening, 0) + len(cautions)
    if not n:
        return "The findings in full" if is_cut else ""
    n_errors = sum(x.severity is Severity.ERROR for x in cautions)
    errors = f", {n_errors} of them errors" if n_errors > 1 else ", 1 of them an error" * n_errors
    return f"{n} more finding{'s' * (n > 1)}{errors}"


# Findings about these stand in the part on searches, all others in that on the model.
OF_SEARCH = (About.STARTS, About.TRIALS, About.EARLIER)
SIDE_BY_SIDE = "Side by side"
RIGHT = "What was tested of the model"
VERDICT_HEADINGS = {
    Verdict.ADEQUATE: RIGHT,
    Verdict.NOT_TESTABLE: "Why the model could not be tested",
}
# A statement and the result that makes it.
Sourced = tuple[Statement, str]


def report_html(results: Sequence[Result], scenes: Mapping[str, KneeScene] | None = None) -> str:
    """The whole page; it needs nothing beside it and fetches nothing.

    Parameters
    ----------
    results
        As `found_results` gives them.
    scenes
        By the digest of the subject, the knee to turn in three dimensions.
    """
    shown = scenes or {}
    subjects = by_subject(results)
    parts_by_name = []
    compared = [
        (f"comparison-{k}", SIDE_BY_SIDE, _comparison_html(x, k))
        for k, x in enumerate(side_by_side(results), 1)
    ]
    for k, (name, x) in enumerate(subject_names(results).items()):
        level = 2 if len(subjects) == 1 else 3
        scene = shown.get(x.results[0].subject_digest)
        parts_by_name.append((name, _subject_html(x, k + 1, level, scene)))
    titles = [x.title for x in subjects] or ["comparison"]
    title = f"Knee report: {', '.join(dict.fromkeys(titles))}"
    done = ", ".join(dict.fromkeys(x.verb for x in results))
    days = sorted({x.record.started[:10] for x in results})
    when = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    stated = _stated_words(subjects[0]) if len(subjects) == 1 else ""
    asked = f"{done} ({stated})" if stated else done
    lead = f"From {asked}, computed {when}. Every sentence links to its numbers."
    maker = f"Made by identknee {versions().get('identknee', '')}".rstrip()
    return document(
        title, parts().body(title, lead, compared, parts_by_name, maker), has_viewer=bool(shown)
    )


def subject_names(results: Sequence[Result]) -> dict[str, Findings]:
    """The subjects by names that tell them apart, those that a comparison gave them first."""
    subjects = by_subject(results)
    titles = [x.title for x in subjects]
    given = {
        y.subject_digest: y.name
        for x in of_type([x.answer for x in comparisons(results)], Comparison)
        for y in x.items
    }
    found: dict[str, Findings] = {}
    for k, x in enumerate(subjects):
        name = x.title
        if titles.count(name) > 1:
            own = given.get(x.results[0].subject_digest) or _stated_words(x) or _folder_words(x)
            taken = f"{name} ({own})" in found or not own
            name = f"{name} ({f'number {titles[: k + 1].count(name)}' if taken else own})"
        found[name] = x
    return found


def _stated_words(findings: Findings) -> str:
    """The uncertainty that was stated of a knee, in the words of the option; empty for none."""
    stated = findings.results[0].record.settings.get("uncertain")
    given = [stated] if isinstance(stated, str) else stated or ()
    words = ", ".join(",".join(given).replace(" ", "").split(","))
    return f"uncertain {words}" if words else ""


def _folder_words(findings: Findings) -> str:
    """The folder of the results of a knee, or the one that all theirs stand in."""
    folders = list(dict.fromkeys(x.folder for x in findings.results))
    if len(folders) == 1:
        return folders[0].name
    parents = {x.parent for x in folders}
    return parents.pop().name if len(parents) == 1 else folders[0].name


def side_by_side(results: Sequence[Result]) -> tuple[Result, ...]:
    """The comparisons among the results; without one that of all knees and tables, if several."""
    if made := comparisons(results):
        return made
    compared = {x: own for x, own in _by_knee_and_table(subject_names(results)) if own}
    return (result_of(comparison(compared)),) if len(compared) > 1 else ()


def _by_knee_and_table(
    subjects: Mapping[str, Findings],
) -> Iterator[tuple[str, tuple[Result, ...]]]:
    """The results of each knee, and where it has several tables of each table, by their names."""
    for name, subject in subjects.items():
        digests = dict.fromkeys(x.data_digest for x in subject.results if x.data_digest)
        tables = [tuple(x for x in subject.results if x.data_digest == y) for y in digests]
        if len(tables) < 2:
            yield name, tables[0] if tables else ()
            continue
        words = [_folder_words(replace(subject, results=x)) for x in tables]
        for k, own in enumerate(tables):
            number = f" {words[: k + 1].count(words[k])}" if words.count(words[k]) > 1 else ""
            own_name = f"{words[k]}{number}"
            yield own_name if len(subjects) == 1 else f"{name} ({own_name})", own


def _comparison_html(result: Result, number: int) -> Markup:
    """What results say side by side, its tables, and its figures."""
    statements = [(x, result.folder.name) for x in statements_of(result.answer)]
    leading = [x for x in statements if x[0].is_answer]
    rest = [x for x in statements if not x[0].is_answer]
    drawn = [
        parts().figure(
            Markup(inline_svg(x.figure, f"c{number}-{x.name}", x.description)), x.caption
        )
        for x in drawings(result)
    ]
    return Markup(parts().part(leading, rest, drawn[:1], drawn[1:]))


def report_tables(results: Sequence[Result]) -> dict[str, tuple[Table, tuple[str, ...]]]:
    """Every table of the page by the name of its file, with what its numbers rest on."""
    found: dict[str, tuple[Table, tuple[str, ...]]] = {}
    subjects, each = subject_names(results), [*side_by_side(results)]
    for name, subject in subjects.items():
        main = [x.answer for x in subject.of_main_data]
        own = f"{file_word(name)}-" if len(subjects) > 1 else ""
        seen = overview(main)
        whole = {ESTIMATES: estimates_table(seen)}
        # The sets hold only under the condition of the verdict.
        verdict = (seen.verdict,) if seen.verdict else ()
        merged = subject.merged.results
        if fits := _fits_together(merged):
            statement = _fits_statement([x.answer for x in fits])
            whole |= {f"fits-{x}": y for x, y in named(statement.tables).items()}
        found |= {f"{own}{x}": (y, (*verdict, *notes_of(main))) for x, y in whole.items() if y.rows}
        each += merged
    for result in each:
        said = named(y for x in statements_of(result.answer) for y in x.tables)
        notes = notes_of([result.answer])
        found |= {f"{_file_start(result)}-{word}": (x, notes) for word, x in said.items()}
    return found


def report_drawings(results: Sequence[Result]) -> Iterator[tuple[str, Drawing]]:
    """Every figure of the page with the name of its file."""
    for result in side_by_side(results):
        for drawing in drawings(result):
            yield f"{_file_start(result)}-{drawing.name}", drawing
    for subject in by_subject(results):
        findings = subject.merged
        shown = progress(findings.results, description="drawing figures")
        pairs = ((x, y) for x in shown for y in drawings(x))
        for result, drawing in chain(pairs, laxity_drawings(findings), load_drawings(findings)):
            yield f"{_file_start(result)}-{drawing.name}", drawing


def _file_start(result: Result) -> str:
    """What names of files of this result begin with: its verb, after its folder if that differs."""
    folder = result.folder.name
    return result.verb if folder == result.verb else f"{folder}-{result.verb}"


def _subject_html(findings: Findings, number: int, level: int, scene: KneeScene | None) -> Markup:
    """The answer, the parts behind it with links to them, and how it was computed."""
    merged = findings.merged
    main = _with_an_answer(overview([x.answer for x in findings.of_main_data]), merged)
    sourced = _sourced_statements(merged.results)
    cautions = merge_duplicate_warnings(
        (warning, source)
        for x, source in sourced
        if x.warning is not None
        for warning in main.opening.without([x.warning])
    )
    figures = _figures(merged, number)
    picture = Markup("").join(x for x, _ in figures.pop(None, []))
    further = _further_commands(findings)
    fits = of_type((x.answer for x in findings.results), Calibration)
    fitted = main_statements(fits[0])[0].tables[:1] if len(fits) == 1 else ()
    lead = lead_of(main, cautions, picture, fitted, further)
    made = [
        ("answer", "The answer", parts().lead(lead, f"findings-{number}", level)),
        ("findings", "More findings", parts().findings(lead.below)),
    ]
    sourced = _said_once(sourced, [*main.said, *main.searches, *main.next_tests])
    for question in Question:
        own = [x for x in sourced if x[0].question is question and x[0].warning is None]
        leading = [x for x in own if x[0].is_answer] or own[:1]
        rest = [x for x in own if x not in leading]
        drawn = figures.get(question, [])
        first, more = ([x for x, is_first in drawn if is_first is y] for y in (True, False))
        content = parts().part(leading, rest, first, more)
        heading = _heading(question, main, merged)
        if question is Question.LAXITY and picture:
            heading = "More of laxity, and all forces"
        made.append((question.value, heading, content))
        if question is Question.NEXT and scene is not None:
            made.append(("knee", "The knee in three dimensions", viewer_html(scene)))
    made.append(("computed", "How this was computed", _computed_html(findings.results)))
    made.append(("further", "What further verbs would answer", parts().further(further)))
    shown = [(f"{key}-{number}", heading, content) for key, heading, content in made if content]
    return Markup(parts().subject(findings.title, shown, level))


def _with_an_answer(found: Overview, findings: Findings) -> Overview:
    """The head of the page; where it would be blank, what the last result says first."""
    if found.said or found.opening.sentences or found.rows or found.searches or found.next_tests:
        return found
    sentence = main_statements(findings.results[-1].answer)[0].sentence
    return replace(found, verdict=sentence, said=(sentence,), tone=Tone.OPEN)


def _said_once(sourced: Iterable[Sourced], said: Iterable[str]) -> list[Sourced]:
    """The statements, those said before without their sentence, or left out without numbers."""
    before, kept = set(said), []
    for statement, source in sourced:
        is_new = statement.sentence not in before
        if is_new or statement.tables:
            own = statement if is_new else replace(statement, sentence="")
            kept.append((own, source))
        before.add(statement.sentence)
    return kept


def _heading(question: Question, main: Overview, findings: Findings) -> str:
    """The heading of a part, as the verdict has it."""
    if question is Question.KNOWN and main.tone is Tone.WRONG:
        return "What would be known if the model were right"
    if question is Question.KNOWN and main.rows and all(x.status in KNOWN for x in main.rows):
        return "What is known"
    if question is Question.WRONG:
        diagnoses = of_type((x.answer for x in findings.results), Diagnosis)
        if not diagnoses:
            return RIGHT
        return VERDICT_HEADINGS.get(diagnoses[-1].verdict, question.heading)
    return question.heading


def _figures(findings: Findings, number: int) -> dict[Question | None, list[tuple[Markup, bool]]]:
    """The figures by the question they belong to, each with whether it is looked at first.

    Under no question stands the one that leads the page: laxity of the table that most results are
    of.
    """
    found: list[tuple[Question | None, str, Drawing, bool, str]] = [
        (
            shows.questions.get(x.name, shows.question),
            f"r{k}",
            x,
            i == 0 and not shows.is_folded,
            f"{_source(result)} ({result.folder.name})",
        )
        for k, result in enumerate(progress(findings.results, description="drawing the report"))
        for shows in [presenter_of(result.answer)]
        for i, x in enumerate(drawings(result))
    ]
    laxity = list(laxity_drawings(findings))
    main = {id(x) for x in findings.of_main_data}
    leading = next((x for result, x in laxity if id(result) in main), None)
    found += [
        (
            None if x is leading else Question.LAXITY,
            f"l{k}",
            x,
            x.name != "laxity-all",
            result.folder.name,
        )
        for k, (result, x) in enumerate(laxity)
    ]
    found += [
        (Question.LAXITY, f"k{k}", x, x.name == KNEE_LOADS, result.folder.name)
        for k, (result, x) in enumerate(load_drawings(findings))
    ]
    placed: dict[Question | None, list[tuple[Markup, bool]]] = {}
    explained: dict[str, tuple[str, str]] = {}
    # In the order of the page: how to read a kind of figure is said at the first one.
    for question, place, x, is_first, source in sorted(
        found, key=lambda x: (x[0] is not None, not x[3])
    ):
        svg = inline_svg(x.figure, f"s{number}{place}-{x.name}", x.description)
        first, other = explained.setdefault(x.caption, (place, source))
        kind = capitalised(x.name.replace("-", " "))
        again = f"{kind}, {source}: read like that of {other}."
        least = least_width(svg) if question is None else None
        html = parts().figure(Markup(svg), x.caption if first == place else again, least)
        placed.setdefault(question, []).append((html, is_first))
    return placed


def _computed_html(results: Sequence[Result]) -> Markup:
    """A table of all results, and their records."""
    rows = tuple(
        (
            x.verb,
            x.folder.name,
            ", ".join(map(_short_path, x.tables)) or "-",
            x.record.started[:16].replace("T", " "),
            x.record.seconds,
            "-" if x.record.seed is None else str(x.record.seed),
        )
        for x in results
    )
    heads = ("verb", "folder", "data", "begun (UTC)", ("time", 1, "s"), "seed")
    records = {f"{x.verb}, {x.folder}": plain(summary_of(x.record)) for x in results}
    return Markup(
        parts().computed(
            table("Results on this page", heads, rows),
            json.dumps(records, indent=2, ensure_ascii=False),
        )
    )


def _further_commands(findings: Findings) -> list[tuple[str, str]]:
    """A question and its command for each that no result answers."""
    done = {x.verb for x in findings.results}
    if "demo" in done:
        done.add("profile")
    of_data = next((x for x in reversed(findings.results) if x.tables), None)
    settings: dict[str, Any] = {"subject": findings.subject}
    if of_data is not None:
        settings = {**of_data.record.settings, **settings, "data": of_data.tables}
    else:
        made = findings.of("demo", "simulate")
        settings["data"] = str(made[0].folder / "laxity.csv") if made else "DATA.csv"
    if "demo" in done:
        settings["noise"] = "0.5mm,0.5deg"
    return [
        (x.suggestion, command_on_data(x.name, settings))
        for x in verbs()
        if x.suggestion and x.name not in done
    ]


def _short_path(path: str) -> str:
    """The last two parts of a path."""
    return "/".join(path.replace("\\", "/").rstrip("/").split("/")[-2:])


def _source(result: Result) -> str:
    tables = listed(map(_short_path, result.tables))
    return f"{result.verb} of {tables}" if tables else result.verb


def _sourced_statements(results: Sequence[Result]) -> list[Sourced]:
    """Statements of results: fits of one table side by side, shared assumptions once."""
    fits = of_type([x.answer for x in results], Calibration)
    together = _fits_together(results)
    sourced: list[Sourced] = []
    for result in results:
        # Warnings of a fit that another one beats do not lead the page.
        is_past = any(has_better_fit(x, fits) for x in of_type([result.answer], Calibration))
        against = warnings(result)
        if is_past:
            against = (replace(x, question=Question.SEARCH, warning=None) for x in against)
        own = [*against, *statements_of(result.answer)]
        if result in together:
            # Main statements of single fits are replaced by the table of all fits.
            own = [x for x in own if not x.is_answer]
            if result is together[0]:
                own.insert(0, _fits_statement([x.answer for x in together]))
        sourced += [(x, _source(result)) for x in own]
    # Assumptions are listed with their source if not shared by all.
    taken = {_source(x): assumption_sentences(x.answer) for x in results}
    sources = [x for x in taken if taken[x]]
    by_sources: dict[tuple[str, ...], list[str]] = {}
    for sentence in dict.fromkeys(x for source in sources for x in taken[source]):
        owners = tuple(x for x in sources if sentence in taken[x])
        by_sources.setdefault(owners, []).append(sentence)
    for owners, sentences in by_sources.items():
        text = " ".join(sentences)
        if len(owners) < len(sources):
            text = f"{capitalised(listed(owners))}: {text}"
        sourced.append((Statement(question=Question.KNOWN, sentence=text), listed(owners)))
    return sourced


def _fits_together(results: Sequence[Result]) -> list[Result]:
    """The fits that ended, of the table that most were made to; none where it is one."""
    ended = [
        x
        for x in results
        if any(y.outcome is not Outcome.START_FAILED for y in of_type([x.answer], Calibration))
    ]
    counts = Counter(x.data_digest for x in ended)
    main, n = counts.most_common(1)[0] if counts else ("", 0)
    return [x for x in ended if x.data_digest == main] if n > 1 else []


def _fits_statement(answers: Sequence[Answer]) -> Statement:
    """Where several fits of one table ended, how well each fits, and their parameters."""
    fits = fits_by_start(answers)
    best = min(fits.values(), key=lambda x: x.objective)
    ends = table(
        "How each fit ended",
        ("start", ("RMSE", None, "mm"), ("RMSE", None, "deg"), ("simulations", 0), "end"),
        (
            (name, x.rmse.mm, x.rmse.deg, x.n_simulations, x.outcome.sentence)
            for name, x in fits.items()
        ),
    )
    values = {
        start: dict(zip(x.parameter_names, x.search.theta.tolist(), strict=True))
        for start, x in fits.items()
    }
    names = [
        name
        for x in fits.values()
        for name in x.parameter_names
        if name not in {y.name for y in x.nuisances}
    ]
    at_bound = {start: parameters_at_bounds(x) for start, x in fits.items()}
    rows = []
    for name in dict.fromkeys(names):
        starts = [x for x in fits if name in at_bound[x]]
        remark = "at its bound" if starts else ""
        if 0 < len(starts) < len(fits):
            remark += f" from {', '.join(starts)}"
        rows.append((label(name), *(values[x].get(name, np.nan) for x in fits), remark))
    parameters = table(
        "Fitted parameters by start",
        ("parameter", *((f"from {start}", None) for start in fits), "remark"),
        rows,
    )
    stated = " The stated errors are those of the fit with the lowest misfit."
    return Statement(
        question=Question.SEARCH,
        sentence=f"The tables set the {len(fits)} fits side by side."
        + stated * bool(best.nuisances),
        tables=(ends, parameters, *nuisance_tables(best)),
        is_answer=True,
    )


def warnings(result: Result) -> Iterator[Statement]:
    """The findings of a result; all but infos lead the page."""
    for x in result.answer.findings:
        yield Statement(
            question=Question.SEARCH if x.kind.about in OF_SEARCH else Question.WRONG,
            sentence=x.line,
            warning=None if x.severity is Severity.INFO else x,
        )


def merge_duplicate_warnings(found: Iterable[tuple[Finding, str]]) -> list[Finding]:
    """Warnings without those that another result gives too, the most severe first.

    Parameters
    ----------
    found
        Each with the result that has it. Where two results find the same, if with other numbers,
        the one with more values stays, else the first; where each has a value that the other lacks
        both stay. Findings whose kinds share a lead become one.
    """
    kept: list[tuple[Finding, str]] = []
    for finding, source in found:
        names = finding.values.keys()
        same = [
            place
            for place, (x, of) in enumerate(kept)
            if x.identity == finding.identity and of != source
            if names <= x.values.keys() or x.values.keys() <= names
        ]
        if not same:
            kept.append((finding, source))
        elif len(names) > len(kept[same[0]][0].values):
            kept[same[0]] = finding, source
    by_lead: dict[object, list[Finding]] = {}
    for place, (finding, _) in enumerate(kept):
        lead = (finding.severity, finding.kind.lead) if finding.kind.lead else place
        by_lead.setdefault(lead, []).append(finding)
    return by_severity(
        replace(own[0], sentence=own[0].kind.sentence(*(x.detail for x in own)))
        if len(own) > 1
        else own[0]
        for own in by_lead.values()
    )
