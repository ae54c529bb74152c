"""Options of the verbs, each said once: command line, defaults and docstrings follow from it.

An option is written as ``Annotated[type, option("What it does.")]`` on the parameter of a verb.
Those that several verbs share stand here under a name. In these texts and in the docstrings of
verbs ``{--out}`` names another option, ``{SUBJECT}`` and ``{DATA}`` the arguments and ``{sd_}`` a
column: the help shows them as typed, the docstring as parameters.
"""

import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypedDict, TypeVar, get_args, get_origin, get_type_hints

from typing_extensions import override

from identknee.calibrate.fit import StartLike
from identknee.laxity.experiment_tables import LaxityLike as OneTable
from identknee.laxity.table import Laxity, TrialsLike
from identknee.model.effects.effect import Effect
from identknee.runs import executors as workers
from identknee.runs.declare import declared, entry
from identknee.runs.files import PathLike
from identknee.subject.knee import Knee, UncertainLike
from identknee.subject.plausibility import PlausibleLike
from identknee.verbs.values import BoundsLike, DiscrepancyLike, NoiseLike

SubjectLike = Knee | PathLike
LaxityLike = OneTable | Sequence[OneTable]
REFERENCE = "reference"
# The attribute of a function that holds its parameters with all that is said of them.
IN_FULL = "__parameters_in_full__"
ERRORS = "\n\nRaises\n------\n"
ABOUT = "__description__"
WIDTH = 92
Function = TypeVar("Function", bound=Callable[..., Any])


@declared
class Option:
    """What is said of a parameter of a verb."""

    text: str = entry("What it does, as the help of the command says it")
    in_python: str = entry("What only callers of the library need to know beside that", default="")
    flag: str = entry(
        "Its name on the command line, if that is not the one of the parameter", default=""
    )
    metavar: str | None = entry("What stands for its value in the help", default=None)
    least: float | None = entry("Smallest value", default=None)
    typed: Any = entry("Type on the command line, if a function takes more", default=None)
    given: Any = entry(
        "What callers may give, if the verb gets what was read from it", default=None
    )
    is_argument: bool = entry("Whether the command line takes it by its place", default=False)
    is_typed: bool = entry("Whether the command line has it", default=True)
    default: Any = entry("Its default, if it is declared by a `TypedDict`", default=None)


class NamesAsTyped(dict[str, str]):
    """What stands on the command line for a name in a text, which is itself unless listed."""

    def __missing__(self, name: str) -> str:
        return name


class NamesInPython(NamesAsTyped):
    """What stands in a docstring for a name in a text."""

    @override
    def __missing__(self, name: str) -> str:
        return {"SUBJECT": "`subject`", "DATA": "`data`"}.get(
            name, f"`{name}`" if name.startswith("--") else f"``{name}``"
        )


def as_typed(text: str) -> str:
    """A text with the names that it mentions as they are typed on the command line."""
    return text.format_map(NamesAsTyped(DATA="DATA.csv"))


def option(text: str, flag: str = "", **more: Any) -> Option:
    """An option of the command line with its dashes; see `Option`."""
    return Option(text=text, flag=flag, **more)


def argument(text: str, metavar: str, **more: Any) -> Option:
    """An argument that the command line takes by its place; see `Option`."""
    return Option(text=text, metavar=metavar, is_argument=True, **more)


PROTOCOLS = (
    "seed63, table2, drawer, a protocol (TOML file), or a laxity table (CSV file, or a subject "
    "that has one)"
)
_A_PROTOCOL = "Or a `Protocol`, a `Laxity` or a pandas ``DataFrame``."
_IN_MEMORY = "Or a `Laxity`, a pandas ``DataFrame``, or a list of tables."
_A_TABLE = (
    "The table of measured laxity, several of one knee, an experiments.toml that lists them, or "
    "the name of a subject that comes with one."
)

Subject = Annotated[
    Knee,
    argument(
        "A subject folder, or a name from: identknee subject list.",
        "SUBJECT",
        in_python="Or a `Knee`.",
        typed=str,
        given=SubjectLike,
    ),
]
Data = Annotated[
    Laxity,
    argument(_A_TABLE, "DATA.csv", in_python=_IN_MEMORY, typed=list[str], given=LaxityLike),
]
MaybeData = Annotated[
    Laxity | None,
    argument(
        f"{_A_TABLE} Leave it out with {{--protocol}}.",
        "DATA.csv",
        in_python=_IN_MEMORY,
        typed=list[str] | None,
        given=LaxityLike | None,
    ),
]
# What the laxity of a diagnosis is before it is read.
GivenData = Annotated[LaxityLike | None, get_args(MaybeData)[1]]
GivenSubject = Annotated[SubjectLike, get_args(Subject)[1]]
Noise = Annotated[
    NoiseLike,
    option(
        "Standard deviations of lengths and angles, such as 0.5mm,0.5deg. They replace the {sd_} "
        "columns of the data.",
        in_python="A text, two numbers in mm and deg, or one number for both.",
        metavar="MM,DEG",
        typed=str | None,
    ),
]
Uncertain = Annotated[
    UncertainLike,
    option(
        "How well the knee and the tests are known, as in insertions=2mm,registration=2deg, in "
        "place of what the subject states; none if known exactly.",
        in_python="A text, several, or sizes by name.",
        metavar="NAME=SIZE,...",
        typed=list[str] | None,
    ),
]
VALUES = (
    "Or values by parameter, as a dictionary, a pandas Series or the answer of a fit; all others "
    "have the subject's."
)
Start = Annotated[
    StartLike,
    option(
        "Where fits start, and the values of parameters held by {--fix}: subject (its own values), "
        "IG1 to IG4 of the paper, or a file ending in .toml.",
        in_python=VALUES,
        typed=str,
    ),
]
ExtraStart = Annotated[
    StartLike,
    option(
        "Where an extra fit of the plain model starts: IG1 to IG4 of the paper or a file ending in "
        ".toml; subject for no extra fit.",
        in_python=VALUES,
        typed=str,
    ),
]
Candidates = Annotated[
    Sequence[Effect] | None,
    option("Causes to consider; the whole library if None.", is_typed=False),
]
Fixed = Annotated[
    Sequence[str] | None,
    option(
        "Hold this parameter at its start, such as ACL.stiffness_kN.",
        "--fix",
        in_python="One name or a list.",
        metavar="NAME",
    ),
]
Bounds = Annotated[
    BoundsLike,
    option(
        "Bounds of a parameter, such as ACL.stiffness_kN=5:15, in place of the subject's own or "
        "of 0 to 40 kN and -15 to 15 %.",
        in_python="A list of texts, or pairs of numbers by name.",
        metavar="NAME=LOW:HIGH",
        typed=list[str] | None,
    ),
]
Keep = Annotated[
    Sequence[str] | None,
    option(
        "Keep this trial although the table contradicts it. * stands for any letters.",
        in_python="One name or a list.",
        metavar="TRIAL",
    ),
]
LeaveOut = Annotated[
    Sequence[str] | None,
    option(
        "Leave out this trial, or all trials of this experiment. Trials that the table "
        "contradicts are left out anyway: see {--keep}.",
        in_python="One name or a list.",
        metavar="TRIAL",
    ),
]
Priors = Annotated[
    bool | None,
    option(
        "Use the priors of ligament parameters, or only their bounds. If not given: sample and "
        "diagnose use them, all others do not.",
    ),
]
Plausible = Annotated[
    PlausibleLike,
    option(
        "Limits of plausibility that count as evidence. default: those of the subject, or "
        "published strengths, strains and contact balance if it has none. none, or a file ending "
        "in .toml. If not given, no limits count.",
        in_python="Or a list of `identknee.subject.Limit`.",
        metavar="default|none|FILE",
        typed=str | None,
    ),
]
Discrepancy = Annotated[
    DiscrepancyLike,
    option(
        "What the model may get wrong, so that intervals allow for it. structures: those of the "
        "library that it lacks, as by {--uncertain} structures=100%. smooth: an error of each "
        "coordinate, smooth in flexion and load, or the scales of its prior, such as 0.5mm,1deg; "
        "smooth stands for 1mm,2deg.",
        in_python="Or two numbers in mm and deg.",
        metavar="none|structures|smooth|MM,DEG",
        typed=str,
    ),
]
# In the texts of the options that take names of predictions.
PREDICTIONS = (
    "Predictions are NAME.tension_N@TRIAL and NAME.strain_pct@TRIAL of a ligament, group or added "
    "structure, contact.medial_N@TRIAL, contact.medial_x_mm@TRIAL (also lateral, y, z, and "
    "meniscus), and coordinates such as varus_deg@TRIAL."
)
Level = Annotated[float, option("Confidence level of the intervals, such as 0.95.")]
Method = Annotated[
    str,
    option("The optimizer: least-squares, complex, genetic, particle-swarm, cma-es or annealing."),
]
LOAD_STEPS = option("Apply the load in small steps, or all at once as in the paper.")
ProtocolName = Annotated[
    TrialsLike,
    option(f"The trials: {PROTOCOLS}.", in_python=_A_PROTOCOL, metavar="PROTOCOL", typed=str),
]
Within = Annotated[
    float,
    option(
        "Uncertainty of the insertions, up to 8 mm. They are moved within it if trials have no "
        "stable pose.",
        metavar="MM",
    ),
]
Seed = Annotated[int, option("Seed of all random numbers. It is stored with the result.", least=0)]
Out = Annotated[
    PathLike | None,
    option(
        "Folder for the results.",
        in_python="Nothing is written if None.",
        metavar="DIR",
        typed=Path,
    ),
]
Workers = Annotated[
    workers.Workers,
    option(
        "Number of processor cores to work on, or the address of a dask scheduler such as "
        "tcp://10.0.0.5:8786. The results do not depend on it.",
        metavar="N",
        typed=str,
        default=1,
    ),
]


class OutOption(TypedDict, total=False):
    """Where results go: `Run.out`."""

    out: Out


class RunOptions(OutOption, total=False):
    """Where results go and who computes them: `Run.out` and `Run.executor`."""

    workers: Workers


class KneeOptions(RunOptions, total=False):
    """Options of a run, and how well the subject is known."""

    uncertain: Uncertain


class DataOptions(KneeOptions, total=False):
    """Options of a run on data: also which trials count; see `Run.trials`."""

    keep: Keep
    leave_out: LeaveOut


class FitOptions(DataOptions, total=False):
    """Options of a run that fits: also whether limits of plausibility count."""

    plausible: Plausible


def trials_option(text: str, flag: str = "") -> Option:
    """An option that names trials; the text ends where their kinds are listed."""
    return option(
        text.replace("{}", PROTOCOLS),
        flag,
        in_python=_A_PROTOCOL,
        metavar="PROTOCOL",
        typed=str | None,
    )


def parameters_in_full(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """All parameters of a verb that users give, annotated with their options, by name."""
    known: dict[str, inspect.Parameter] | None = getattr(function, IN_FULL, None)
    return known if known is not None else dict(_expanded(inspect.signature(function)))


def _expanded(signature: inspect.Signature) -> Iterator[tuple[str, inspect.Parameter]]:
    """The parameters; in place of ``**_: Unpack[...]`` those that its `TypedDict` declares."""
    for name, own in signature.parameters.items():
        if own.kind is not inspect.Parameter.VAR_KEYWORD:
            yield name, own
            continue
        (declared,) = get_args(own.annotation)
        for key, annotation in get_type_hints(declared, include_extras=True).items():
            yield (
                key,
                inspect.Parameter(
                    key,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=option_of(annotation).default,
                    annotation=annotation,
                ),
            )


def option_of(annotation: Any) -> Option:
    """What is said of a parameter with this annotation.

    Raises
    ------
    TypeError
        If nothing is.
    """
    found = [x for x in get_args(annotation)[1:] if isinstance(x, Option)]
    if get_origin(annotation) is not Annotated or not found:
        raise TypeError(f"nothing is said of an option of type {annotation}")
    return found[0]


def documented(function: Function) -> Function:
    """The function with its options in signature and docstring, as users of the library see it."""
    return explained(function, dict(_expanded(inspect.signature(function))))


def explained(function: Function, parameters: Mapping[str, inspect.Parameter]) -> Function:
    """The function with these parameters in signature and docstring."""
    plain = [x.replace(annotation=_plain(x.annotation)) for x in parameters.values()]
    back = inspect.signature(function).return_annotation
    setattr(function, IN_FULL, parameters)
    # Readers of a docstring see plain types; those of the command line ask for the options.
    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        plain, return_annotation=back
    )
    function.__annotations__ = {x.name: x.annotation for x in plain} | {"return": back}
    doc = inspect.cleandoc(function.__doc__ or "")
    setattr(function, ABOUT, as_typed(doc.partition(ERRORS)[0].partition("\n\n")[2]))
    function.__doc__ = _with_parameters(doc, parameters)
    return function


def description_of(function: Callable[..., Any]) -> str:
    """What the docstring of a verb says beside its first line, in the words of the help."""
    return str(getattr(function, ABOUT))


def _plain(annotation: Any) -> Any:
    said = option_of(annotation)
    return get_args(annotation)[0] if said.given is None else said.given


def _with_parameters(doc: str, parameters: Mapping[str, inspect.Parameter]) -> str:
    """A docstring with its section of parameters, before that of errors."""
    names = NamesInPython(
        {
            option_of(x.annotation).flag or f"--{name.replace('_', '-')}": f"`{name}`"
            for name, x in parameters.items()
        }
    )
    entries = []
    for name, x in parameters.items():
        said = option_of(x.annotation)
        # Marks that reStructuredText would read as its own.
        text = f"{said.text} {said.in_python}".strip().replace("*", "\\*")
        text = text.format_map(names)
        entries.append(f"{name}\n{textwrap.indent(textwrap.fill(text, WIDTH), '    ')}")
    section = "\n".join(["Parameters\n----------", *entries])
    head, line, rest = doc.partition(ERRORS)
    return f"{head.format_map(names)}\n\n{section}{line}{rest}\n"
