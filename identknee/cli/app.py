"""The command `identknee`: its verbs, the commands that leave no answer in files, and how all end.

Arguments, options and help of the verbs follow from their signatures.
"""

import errno
import inspect
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

import typer
import typer.core
from typing_extensions import override

import identknee as ik
from identknee.laxity.named_tables import TABLES
from identknee.runs.crash_report import report_unexpected_error, warnings_to_log
from identknee.runs.errors import InputError, NotComputable
from identknee.runs.executors import WorkerTerminated
from identknee.runs.files import plain, write_atomically
from identknee.runs.findings import Severity
from identknee.subject.examples import named_subject
from identknee.verbs.registry import Verb, verb_named, verbs

if TYPE_CHECKING:
    from identknee.verbs.answer import Answer

# An error sentence may quote a path or value that is absurdly long.
LONGEST_SENTENCE = 2000
# Files store seeds as 64-bit integers; no computer finishes more than the largest count.
LARGEST_SEED, LARGEST_COUNT = 2**63 - 1, 10**8
NOT_COMPUTED, WRONG_INPUT, INTERRUPTED = 1, 2, 130
STOPPED = "stopped; the same command does it again from the start"
STOPPED_WORK = "stopped; what was finished is kept in --out, and the same command resumes"
# Keys of the context: the options of the call, and whether the call itself makes --out.
SETTINGS, IS_NEW = "identknee.settings", "identknee.is_new"


Json = Annotated[bool, typer.Option("--json", help="Print only result.json, to standard output.")]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", help="Print all that the answer says, not only what changes what to do."
    ),
]


class Command(typer.core.TyperCommand):
    """A command that stores its options for the error handling of its group."""

    @override
    def invoke(self, ctx: Any) -> Any:
        """Result of the verb."""
        out = ctx.params.get("out")
        ctx.meta[SETTINGS] = ctx.params
        ctx.meta[IS_NEW] = out is not None and not Path(out).exists()
        for name, value in ctx.params.items():
            most = LARGEST_SEED if name == "seed" else LARGEST_COUNT
            if isinstance(value, int) and value > most:
                option = f"--{name.replace('_', '-')}"
                raise ValueError(f"{option} is too large; give at most {most}")
        return super().invoke(ctx)


class CommandGroup(typer.core.TyperGroup):
    """Commands that end with a sentence and an exit code instead of a traceback."""

    @override
    def invoke(self, ctx: Any) -> Any:
        """Result of the verb, with errors turned into exit codes."""
        try:
            with warnings_to_log():
                return super().invoke(ctx)
        except KeyboardInterrupt:
            verb = verb_named(ctx.invoked_subcommand)
            is_kept = verb is not None and verb.resumes
            sentence, code = STOPPED_WORK if is_kept else STOPPED, INTERRUPTED
        # The one place where an error ends, foreseen or not.
        except Exception as error:
            if _ends_command(error):
                raise
            settings = ctx.meta.get(SETTINGS, {})
            out = settings.get("out")
            folder = out if out is not None and out.is_dir() else None
            sentence, code = _expected_error(error) or (
                report_unexpected_error(error, settings, folder),
                NOT_COMPUTED,
            )
        if ctx.meta.get(IS_NEW):
            with suppress(OSError):
                ctx.meta[SETTINGS]["out"].rmdir()
        # The sentence may quote a binary file.
        shown = sentence.replace("\n", " ")[:LONGEST_SENTENCE]
        line = "".join(x if x.isprintable() else "?" for x in shown)
        typer.echo(f"identknee: {line}", err=True)
        raise typer.Exit(code)


def _ends_command(error: Exception) -> bool:
    """Whether typer itself should handle an exception: its own ones and a closed pipe."""
    # A closed pipe, as in `identknee ... | head`, is no error.
    if isinstance(error, OSError):
        return error.errno == errno.EPIPE
    # A missing argument is better answered by the usage, which typer shows.
    is_typers = hasattr(error, "exit_code") or isinstance(error, typer.Abort)
    return is_typers and type(error) is not typer.BadParameter


def _expected_error(error: Exception) -> tuple[str, int] | None:
    """The message for the user and the exit code; None for an unexpected error."""
    if isinstance(error, typer.BadParameter):
        return option_sentence(error), WRONG_INPUT
    if isinstance(error, NotComputable | ModuleNotFoundError | WorkerTerminated):
        # Messages of identknee already say what to do; those of Python's import do not.
        is_python = isinstance(error, ModuleNotFoundError) and error.name is not None
        hint = ". To see what is missing: identknee doctor" if is_python else ""
        return f"{error}{hint}", NOT_COMPUTED
    if isinstance(error, MemoryError):
        return "there is not enough memory", NOT_COMPUTED
    if isinstance(error, OSError):
        return f"a file or folder cannot be used: {error}", WRONG_INPUT
    if isinstance(error, ValueError) and is_identknee_error(error):
        return str(error), WRONG_INPUT
    return None


def option_sentence(error: typer.BadParameter) -> str:
    """What is wrong with an option and where to read about it, as one sentence."""
    where = "identknee" if error.ctx is None else error.ctx.command_path
    # pydantic puts a prefix before the message and a full stop behind it.
    message = error.format_message().replace("Value error, ", "").rstrip(".")
    return f"{message}. See: {where} --help"


def is_identknee_error(error: ValueError) -> bool:
    """Whether the error was raised by identknee for the caller, rather than inside a library."""
    if isinstance(error, InputError):
        return True
    # An error from a worker process carries its traceback as text.
    remote = str(getattr(error.__cause__, "tb", ""))
    if remote:
        return "identknee" in remote.rpartition('File "')[2].partition('"')[0]
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    module = "" if trace is None else str(trace.tb_frame.f_globals.get("__name__", ""))
    return module.partition(".")[0] == "identknee"


def show(summary: Mapping[str, Any], lines: Sequence[str], *, as_json: bool) -> None:
    """Print the summary as JSON, or the lines for a person."""
    if as_json:
        typer.echo(json.dumps(plain(summary), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo("\n".join(lines))


NOTHING_HOLDS = "an error was found ({}), and nothing computed holds"


def finished(
    answer: "Answer", out: Path, *, then: str, as_json: bool, is_verbose: bool = False
) -> None:
    """Print an answer, and leave where nothing was computed or nothing computed holds."""
    # These load xarray and what draws tables, which takes longer than most mistakes.
    from identknee.runs.schema import summary_of

    lines = [] if as_json else [str(answer) if is_verbose else answer.brief()]
    lines += [f"Results: {out}", *([then] if then else [])]
    show(summary_of(answer), lines, as_json=as_json)
    if answer.remark:
        typer.echo(answer.remark, err=True)
    if answer.failure:
        # In full with --json, which prints no findings as text, or where no finding says it.
        own = [x.code for x in answer.findings if x.sentence == answer.failure]
        is_said = own and not as_json
        raise NotComputable(NOTHING_HOLDS.format(own[0]) if is_said else answer.failure)


def end_with_errors(answer: "Answer") -> None:
    """Leave with exit code 1 if the answer has a finding that is an error.

    The message names the codes only: the answer has the sentences.
    """
    codes = dict.fromkeys(x.code for x in answer.findings if x.severity is Severity.ERROR)
    if codes:
        raise NotComputable(
            f"an error was found ({', '.join(codes)}); do not use the numbers before its cause is "
            "known"
        )


def print_result(found: Any, *lines: str, as_json: bool) -> None:
    """Print the result of a command that writes no files: as JSON, or as text."""
    summary = {}
    if as_json:
        # `doctor` must print its text even where xarray is missing, which this loads.
        from identknee.runs.schema import summary_of

        summary = summary_of(found)
    show(summary, [str(found), *lines], as_json=as_json)
    if failure := getattr(found, "failure", ""):
        raise NotComputable(failure)


# Every command has these, also where one changes nothing, so that scripts can give them to all.
LAST = ("out", "seed", "workers")
RESUMES = "A stopped run resumes."
PAGE = "report.html"


class VerbGroup(CommandGroup):
    """A group whose verbs become full commands only when they are called."""

    # The word in front of its commands.
    word = ""

    @override
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        names = [x.name.rpartition(" ") for x in verbs() if x.summary]
        own = {last: f"{word} {last}".strip() for word, _, last in names if word == self.word}
        waiting = {x.name: x for x in verbs() if x.name in own.values()}
        made = {last: WaitingCommand(waiting[name], last) for last, name in own.items()}
        # In a subgroup its own command `list` comes first.
        self.commands = {**self.commands, **made} if self.word else {**made, **self.commands}


class SubjectGroup(VerbGroup):
    """The commands that begin with the word subject."""

    word = "subject"


class WaitingCommand(typer.core.TyperCommand):
    """A placeholder with the help line of a verb; calling it loads the real command."""

    def __init__(self, verb: Verb, name: str) -> None:
        super().__init__(name, help=verb.summary, rich_markup_mode=None)
        self.verb = verb

    @override
    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """The context of the command itself, which is made here."""
        try:
            return command_of(self.verb).make_context(*args, **kwargs)
        except Exception as error:
            # Typer keeps the class of this error to itself.
            unknown: Any = error
            if others := _verbs_with(getattr(unknown, "option_name", "")):
                unknown.message += f". It is an option of {others}."
            raise


def _verbs_with(option: str) -> str:
    """Names of the verbs that have an option; empty if none has."""
    from identknee.verbs.options import option_of, parameters_in_full

    def flags(verb: Verb) -> Iterator[str]:
        for name, own in parameters_in_full(verb.call).items():
            stated = option_of(own.annotation)
            if stated.is_typed and not stated.is_argument:
                yield stated.flag or f"--{name.replace('_', '-')}"

    return ", ".join(x.name for x in verbs() if x.summary and option in flags(x))


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
            from identknee.report.results import found_results
            from identknee.report.write_report import write_report

            write_report(found_results(out), out / PAGE)
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
        # A single name keeps typer from adding the opposite flag --no-NAME.
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
    if typed is not None:
        return typed
    inner = get_args(annotation)[0]
    return list[str] | None if inner == Sequence[str] | None else inner


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
    from identknee.report.results import found_results
    from identknee.report.table_files import forms_of
    from identknee.report.write_report import FIGURES, TABLES, write_report

    forms = forms_of(tables or "")
    if figures is None and (data or width):
        raise ValueError("--data and --width are of figures; add --figures svg or --figures pdf")
    summary = write_report(
        found_results(folder),
        out or folder / PAGE,
        figures=figures,
        tables=forms,
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
