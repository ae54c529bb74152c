"""The commands of the verbs: their arguments, options and help follow from the signatures."""

import inspect
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
import typer.core
from typing_extensions import override

import identknee as ik
from identknee.cli.command import Command, CommandGroup, Json, Verbose, end_with_errors, finished
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
