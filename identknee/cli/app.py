"""The command `identknee`: its verbs, and the commands that leave no answer in files.

Arguments, options and help of the verbs follow from their signatures.
"""

import inspect
import os
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
import typer.core
from typing_extensions import override

import identknee as ik
from identknee.cli.command import (
    Command,
    CommandGroup,
    Json,
    Verbose,
    end_with_errors,
    finished,
    print_result,
    show,
)
from identknee.laxity.named_tables import TABLES
from identknee.runs.files import write_atomically
from identknee.subject.examples import named_subject
from identknee.verbs.registry import Verb, verbs

# Every command has these, also where one changes nothing, so that scripts can give them to all.
LAST = ("out", "seed", "workers")
RESUMES = "A stopped run resumes."
PAGE = "report.html"


class VerbGroup(CommandGroup):
    """Commands, of which those of the verbs are made when they are called."""

    # The word in front of its commands.
    word = ""

    @override
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        names = [x.name.rpartition(" ") for x in verbs() if x.summary]
        own = {last: f"{word} {last}".strip() for word, _, last in names if word == self.word}
        waiting = {x.name: x for x in verbs() if x.name in own.values()}
        made = {last: WaitingCommand(waiting[name], last) for last, name in own.items()}
        # A list of what there is comes before what to do with it.
        self.commands = {**self.commands, **made} if self.word else {**made, **self.commands}


class SubjectGroup(VerbGroup):
    """The commands that begin with the word subject."""

    word = "subject"


class WaitingCommand(typer.core.TyperCommand):
    """The command of a verb, of which only the line of help is known until it is called."""

    def __init__(self, verb: Verb, name: str) -> None:
        super().__init__(name, help=verb.summary, rich_markup_mode=None)
        self.verb = verb

    @override
    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """The context of the command itself, which is made here."""
        return command_of(self.verb).make_context(*args, **kwargs)


def command_of(verb: Verb) -> typer.core.TyperCommand:
    """The command of a verb; its module is loaded here."""
    from identknee.verbs.options import description_of, parameters_in_full

    def called(context: typer.Context, **_: Any) -> None:
        arguments = dict(context.params)
        as_json, out = arguments.pop("as_json"), arguments["out"]
        is_verbose = arguments.pop("is_verbose")
        if verb.beginning and not as_json:
            typer.echo(verb.beginning.format(**arguments), err=True)
        call = verb.call
        answer = call(**{k: arguments[k] for k in parameters_in_full(call) if k in arguments})
        then = verb.then.format(out=out)
        finished(answer, out, then=then, as_json=as_json, is_verbose=is_verbose)
        # What follows loads matplotlib, which takes longer than most mistakes.
        if verb.has_pictures:
            from identknee.report.figures import png
            from identknee.report.presenter import presenter_of

            knee = ik.read_subject(arguments.get("subject", "reference"))
            drawn = presenter_of(answer).pictures(answer, knee)
            # All are drawn before any is written, so that no half of them is left.
            for name, picture in {x: png(y) for x, y in drawn.items()}.items():
                write_atomically(out / f"{name}.png", picture)
        if verb.has_page:
            from identknee.report.write_report import write_report

            write_report(out, out / PAGE)
            if not as_json:
                typer.echo(f"Open in a browser: {out / PAGE}")
        end_with_errors(answer)

    more = [description_of(verb.call), *([RESUMES] if verb.resumes else [])]
    called.__doc__ = f"{verb.summary}\n\n{' '.join(more)}".strip()
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY)
    parameters = [context.replace(annotation=typer.Context), *_parameters(verb)]
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {x.name: x.annotation for x in parameters}
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    epilog = f"Example: identknee {verb.name} {verb.example}"
    app.command(verb.name.rpartition(" ")[2], cls=Command, epilog=epilog)(called)
    made: typer.core.TyperCommand = typer.main.get_command(app)  # type: ignore[assignment]
    return made


def _parameters(verb: Verb) -> Iterator[inspect.Parameter]:
    """The parameters of the command in the order of its help."""
    from identknee.verbs.options import Seed, Workers, option_of, parameters_in_full

    known = parameters_in_full(verb.call)
    shared = {
        name: inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
        )
        for name, default, annotation in (("seed", 0, Seed), ("workers", 1, Workers))
    }
    given = shared | dict(known)
    for name in sorted(given, key=lambda x: (x in LAST and 1 + LAST.index(x), x not in known)):
        if option_of(given[name].annotation).is_typed:
            yield _parameter(given[name], verb)
    for name, annotation in (("as_json", Json), ("is_verbose", Verbose)):
        own = inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False)
        yield own.replace(annotation=annotation)


def _parameter(own: inspect.Parameter, verb: Verb) -> inspect.Parameter:
    """A parameter of a verb as typer takes it."""
    from identknee.verbs.options import as_typed, option_of

    stated = option_of(own.annotation)
    typed = _typed(own.annotation, stated.typed)
    is_list = list in (get_origin(x) for x in (typed, *get_args(typed)))
    text = as_typed(stated.text) + " May be repeated." * is_list
    default = own.default
    if own.name == "out":
        default = Path(verb.folder)
    elif typed is str and isinstance(default, int):
        default = str(default)
    elif is_list and isinstance(default, str):
        default = (default,)
    about: Any
    callback = CALLBACKS.get(own.name)
    if stated.is_argument:
        metavar = stated.metavar if default is own.empty else f"[{stated.metavar}]"
        about = typer.Argument(metavar=metavar, help=text, callback=callback)
    else:
        # A flag has no opposite, as a single name says.
        flags = [stated.flag or f"--{own.name.replace('_', '-')}"] * bool(
            stated.flag or typed is bool
        )
        about = typer.Option(
            *flags, metavar=stated.metavar, min=stated.least, help=text, callback=callback
        )
    return inspect.Parameter(
        own.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[typed, about],
    )


def _typed(annotation: Any, typed: Any) -> Any:
    """The type on the command line."""
    if typed is not None:
        return typed
    plain = get_args(annotation)[0]
    return list[str] | None if plain == Sequence[str] | None else plain


def _subject_word(word: str) -> str:
    return _note_if_ambiguous(word, is_name=named_subject(word) is not None)


def _data_words(words: list[str] | None) -> list[str] | None:
    for word in words or ():
        _note_if_ambiguous(word, is_name=word in TABLES)
    return words


def _note_if_ambiguous(word: str, *, is_name: bool) -> str:
    """The word; if it is both a name and a path, a note says which is used."""
    if is_name and Path(word).exists():
        typer.echo(
            f"identknee: {word} means what comes with identknee under this name; "
            f"write .{os.sep}{word} for what is called so here.",
            err=True,
        )
    return word


def _workers(word: str) -> int | str:
    """A number of workers, or the address of a scheduler."""
    if "://" in word:
        return word
    if not word.isdecimal() or int(word) < 1:
        raise typer.BadParameter(
            f"{word} is neither a number of processes nor the address of a scheduler; "
            "write for example 4, or tcp://10.0.0.5:8786"
        )
    return int(word)


CALLBACKS: dict[str, Callable[..., Any]] = {
    "subject": _subject_word,
    "data": _data_words,
    "workers": _workers,
}


app = typer.Typer(
    cls=VerbGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help needs no rich, which takes longer to load than everything else here.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"identknee {version('identknee')}")
        raise typer.Exit


@app.callback()
def identknee(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Fit knee ligament parameters to laxity tests, and see how far the fit can be trusted.

    SUBJECT is a subject folder, or a name from: identknee subject list. A command that computes
    writes result.json, and result.nc with all arrays, to the folder --out. Exit codes: 0 done,
    1 it could not be computed or an error was found, 2 the input is wrong.
    """


Folder = Annotated[
    Path,
    typer.Argument(
        metavar="DIR", help="Results folder of any command, or a folder of such folders."
    ),
]
File = Annotated[
    Path | None, typer.Option(metavar="FILE", help="The page.  [default: DIR/report.html]")
]
Figures = Annotated[
    Literal["svg", "pdf"] | None,
    typer.Option(
        help="Also write every figure for a paper, to the folder figures beside the page."
    ),
]

Tables = Annotated[
    str | None,
    typer.Option(
        metavar="FORM,...",
        help="Also write every table, to the folder tables beside the page: csv, latex or "
        "markdown, or several, as in csv,latex.",
    ),
]

Data = Annotated[
    Literal["csv"] | None,
    typer.Option(help="With --figures: also write the numbers of each figure beside it."),
]
Width = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        min=1.0,
        help="With --figures: their width, such as 89 or 183 for one or two columns of a journal.",
    ),
]
Methods = Annotated[
    bool,
    typer.Option(
        "--methods",
        help="Also write methods.md: how each result was computed, as a paragraph for a paper.",
    ),
]


def report(
    folder: Folder,
    out: File = None,
    figures: Figures = None,
    data: Data = None,
    width: Width = None,
    tables: Tables = None,
    methods: Methods = False,
    as_json: Json = False,
) -> None:
    """Write the results in DIR as one page that works offline.

    The answer comes first, with the numbers behind each sentence: what is known and what is
    not, what the model gets wrong, which test to do next. It takes the results of all commands
    in DIR and in the folders in it, subject by subject.
    """
    # This loads xarray and matplotlib, which takes longer than most mistakes.
    from identknee.report.table_files import forms_of
    from identknee.report.write_report import FIGURES, TABLES, write_report

    forms = forms_of(tables or "")
    if figures is None and (data or width):
        raise ValueError("--data and --width are of figures; add --figures svg or --figures pdf")
    summary = write_report(
        folder,
        out or folder / PAGE,
        figures,
        forms,
        methods=methods,
        data=data is not None,
        width_mm=width,
    )
    found = ", ".join(x["verb"] for x in summary["results"])
    lines = [f"Report on {found}: {summary['report']}", *summary["remarks"]]
    beside = Path(summary["report"]).parent
    if figures is not None:
        lines.append(f"{len(summary['figures'])} figures: {beside / FIGURES}")
    if forms:
        lines.append(f"{len(summary['tables'])} files of tables: {beside / TABLES}")
    if methods:
        lines.append(f"Methods: {summary['methods']}")
    show(summary, lines, as_json=as_json)


BlindFolder = Annotated[
    Path, typer.Argument(metavar="BLIND_DIR", help="A folder that `identknee blind` wrote.")
]
DiagnosisFolder = Annotated[
    Path, typer.Argument(metavar="DIAGNOSIS_DIR", help="A folder that `identknee diagnose` wrote.")
]


def reveal(blind_dir: BlindFolder, diagnosis_dir: DiagnosisFolder, as_json: Json = False) -> None:
    """Reveal a hidden effect, and score its diagnosis."""
    print_result(ik.blind_test.reveal(blind_dir, diagnosis_dir), as_json=as_json)


def list_all(as_json: Json = False) -> None:
    """List the subjects that come with identknee.

    Sources and licences stand with each. Use a name wherever a command wants SUBJECT. A subject
    with measured laxity also stands for its DATA.csv.
    """
    print_result(
        ik.verbs.list_subjects(),
        "Next: identknee subject check NAME, or identknee simulate NAME",
        as_json=as_json,
    )


ChecksJson = Annotated[
    bool, typer.Option("--json", help="Print the checks as JSON, and nothing else.")
]


def doctor(as_json: ChecksJson = False) -> None:
    """Check this installation, with a short self-test.

    It looks at versions, cores, cache and extras. The self-test repeats known trials of the
    reference knee. The first one after an installation compiles, which takes up to a minute. The
    exit code is 1 if anything is wrong.
    """
    print_result(ik.verbs.doctor(), as_json=as_json)


subject = typer.Typer(
    cls=SubjectGroup,
    help="List, check, show, settle, export or import a subject.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
subject.command("list", epilog="Example: identknee subject list --json")(list_all)
app.add_typer(subject, name="subject")
# What gives no answer with files; the verbs are commands by themselves.
for command, words in (
    (reveal, "blind7 identknee-diagnose"),
    (report, "identknee-demo"),
    (doctor, ""),
):
    epilog = f"Example: identknee {command.__name__} {words}".rstrip()
    app.command(cls=Command, epilog=epilog)(command)
