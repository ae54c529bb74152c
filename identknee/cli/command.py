"""How commands end: what they print, their exit codes, and what they leave behind."""

import errno
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core
from typing_extensions import override

from identknee.runs.crash_report import report_unexpected_error, warnings_to_log
from identknee.runs.errors import InputError, NotComputable
from identknee.runs.executors import WorkerTerminated
from identknee.runs.files import plain
from identknee.runs.findings import Severity
from identknee.verbs.registry import verb_named

if TYPE_CHECKING:
    from identknee.verbs.answer import Answer

# Of a path or a value that is absurdly long.
LONGEST_SENTENCE = 2000
# What files can hold, and what no computer can do.
LARGEST_SEED, LARGEST_COUNT = 2**63 - 1, 10**8
NOT_COMPUTED, WRONG_INPUT, INTERRUPTED = 1, 2, 130
STOPPED = "stopped; the same command does it again from the start"
STOPPED_WORK = "stopped; what was finished is kept in --out, and the same command resumes"
# What a verb was called with, and whether its folder --out is its own.
SETTINGS, IS_NEW = "identknee.settings", "identknee.is_new"


Json = Annotated[bool, typer.Option("--json", help="Print only result.json, to standard output.")]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", help="Print all that the answer says, not only what changes what to do."
    ),
]


class Command(typer.core.TyperCommand):
    """A verb that leaves the values it was called with to its group."""

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
    """Verbs that end with a sentence and an exit code instead of a traceback."""

    @override
    def invoke(self, ctx: Any) -> Any:
        """Result of the verb, its mistakes turned into exit codes."""
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
        # A file that is no text may bring anything into the sentence about it.
        plain = sentence.replace("\n", " ")
        line = "".join(x if x.isprintable() else "?" for x in plain[:LONGEST_SENTENCE])
        typer.echo(f"identknee: {line}", err=True)
        raise typer.Exit(code)


def _ends_command(error: Exception) -> bool:
    """Whether an exception is how typer ends a command, or one that it answers itself."""
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
        # That Python reported a missing module; identknee itself says what to do.
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
    # The library that checks types puts words before the message and a full stop behind it.
    message = error.format_message().replace("Value error, ", "").rstrip(".")
    return f"{message}. See: {where} --help"


def is_identknee_error(error: ValueError) -> bool:
    """Whether the error was raised by identknee for the caller, rather than inside a library."""
    if isinstance(error, InputError):
        return True
    # An error from a worker process brings the trace of where it was raised as text.
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
        # In full where the answer is no text, or does not say it.
        own = [x.code for x in answer.findings if x.sentence == answer.failure]
        is_said = own and not as_json
        raise NotComputable(NOTHING_HOLDS.format(own[0]) if is_said else answer.failure)


def end_with_errors(answer: "Answer") -> None:
    """Leave with exit code 1 if the answer has a finding that is an error.

    The sentence has its code alone: what was found stands in the answer.
    """
    codes = dict.fromkeys(x.code for x in answer.findings if x.severity is Severity.ERROR)
    if codes:
        raise NotComputable(
            f"an error was found ({', '.join(codes)}); do not use the numbers before its cause is "
            "known"
        )


def print_result(found: Any, *lines: str, as_json: bool) -> None:
    """Print what a function found that leaves no files: as JSON, or in its own words."""
    summary = {}
    if as_json:
        # A broken installation, of which only words are wanted, may lack what this loads.
        from identknee.runs.schema import summary_of

        summary = summary_of(found)
    show(summary, [str(found), *lines], as_json=as_json)
    if failure := getattr(found, "failure", ""):
        raise NotComputable(failure)
