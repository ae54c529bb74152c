"""One scaffold for all verbs: read, record, resume, time, write.

Arguments from Python are taken as a verb wants them: tables in memory, single names, numbers.
"""

import functools
import inspect
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar, get_args, get_origin, overload
from typing import Protocol as TypedProtocol

import numpy as np

from identknee.calibrate.fit import StartLike
from identknee.checks.left_out_trials import TrialsAsked, trials_asked
from identknee.laxity.data_frame import NAME as FRAME
from identknee.laxity.data_frame import Frame, is_frame
from identknee.laxity.experiment_tables import is_experiments, read_experiments
from identknee.laxity.named_tables import TABLES, laxity_file
from identknee.laxity.protocol import BUILT_IN, Protocol
from identknee.laxity.table import TABLE_FILES, Laxity, check_is_table, read_laxity
from identknee.model.effects.effect import MechanicalEffect, ObservationEffect
from identknee.model.laxity_model import LaxityModel
from identknee.runs.errors import ValueRefused, closest, suggestion
from identknee.runs.executors import Executor, Workers, executor_of, one_library_thread
from identknee.runs.files import digest, prepare_folder
from identknee.runs.findings import Finding, without_repeats
from identknee.runs.progress import progress_bar
from identknee.runs.record import record
from identknee.runs.store import Store, finish_work, open_work
from identknee.subject.check import geometry_warnings
from identknee.subject.examples import named_subject
from identknee.subject.folder import FILE, read_subject
from identknee.subject.knee import EXACTLY, Knee, UncertainLike, with_stated_uncertainty
from identknee.subject.plausibility import Limit
from identknee.verbs import options
from identknee.verbs.answer import Answer, question
from identknee.verbs.options import IN_FULL, explained, option_of, parameters_in_full
from identknee.verbs.values import STRUCTURES, noise_of, noise_words

SUBJECT, DATA, PROTOCOL, FIXED = "subject", "data", "protocol", "fixed"
SUBJECT_FILES = (".toml", ".osim")
# The types that sizes of noise may have, and no other option has together.
NOISE = frozenset({str, float, tuple[float, float]})
WHOLE = frozenset({int, type(None)})
# Those of a start.
START = frozenset(get_args(StartLike))
ORDER = "give the subject first and the laxity table second"


def read_arguments(
    parameters: Mapping[str, inspect.Parameter], arguments: Mapping[str, Any]
) -> dict[str, Any]:
    """The arguments of a verb: data frames read, one name as a list of one, noise with its units.

    Parameters
    ----------
    parameters
        Those of the verb, annotated with their options.
    arguments
        What was given for each.

    Raises
    ------
    ValueError
        If subject and data have changed places, either is of another kind, or a word is none of
        those to choose from.
    """
    _check_places(arguments)
    return {x: _as_taken(x, parameters[x].annotation, given) for x, given in arguments.items()}


def _as_taken(name: str, annotation: Any, given: Any) -> Any:
    """One argument."""
    plain = get_args(annotation)[0]
    kinds = frozenset(get_args(plain) or (plain,))
    are_values = any(get_origin(x) is Mapping for x in kinds)
    given = _plain(given, is_series=are_values)
    if name == DATA and isinstance(given, list | tuple):
        tables = [_as_taken(name, annotation, x) for x in given]
        return tables[0] if len(tables) == 1 else _numbered(tables) or None
    # A choice of words, alone or beside None.
    words = [y for x in (plain, *kinds) if get_origin(x) is Literal for y in get_args(x)]
    if words and given not in words and not (given is None and type(None) in kinds):
        raise ValueError(f"{name} {given}: it is none of {', '.join(words)}")
    if kinds >= START:
        return _start(given)
    if is_frame(given) and (name == DATA or Frame in kinds):
        return read_laxity(given, is_measured=name == DATA)
    if Sequence[str] in kinds and str not in kinds:
        return _names(name, given, are_values=are_values)
    if int in kinds and kinds <= WHOLE and not (given is None and type(None) in kinds):
        return _whole(name, option_of(annotation).least, given)
    return noise_words(given) if kinds >= NOISE else given


def _whole(name: str, least: float | None, given: Any) -> int:
    """A whole number, however it was given."""
    is_truth = isinstance(given, bool)
    is_number = isinstance(given, Real) and not is_truth and float(given).is_integer()
    if not is_number or (least is not None and given < least):
        at_least = "" if least is None else f" of at least {least:g}"
        raise ValueRefused(f"{name} is {given!r}", f"give a whole number{at_least}")
    return int(given)


def _bound(function: Callable[..., Any], called: Any, args: Any, kwargs: Any) -> Any:
    """The arguments by their names; a mistake is said with what the verb takes."""
    known = called.__signature__.parameters
    try:
        return called.__signature__.bind(*args, **kwargs)
    except TypeError as error:
        name, said = function.__name__, str(error)
        flags = {
            (option_of(x.annotation).flag or f"--{k}")[2:].replace("-", "_"): k
            for k, x in getattr(called, IN_FULL).items()
        }
        placed = [k for k, x in known.items() if x.kind is not x.KEYWORD_ONLY]
        for other in kwargs:
            if other not in known:
                close = closest(other, flags)
                remedy = f"Did you mean {flags[close]}?" if close else suggestion(other, known)
                raise TypeError(f"{name} has no argument {other}. {remedy}") from None
        if len(args) > len(placed):
            said = f"takes {' and '.join(placed) or 'nothing'} by place alone; name all others"
        raise TypeError(f"{name}: {said}") from None


def _numbered(tables: Sequence[Any]) -> list[Any]:
    """The tables, data frames with a number in their names, which are the same."""
    named, found = 0, []
    for x in tables:
        if isinstance(x, Laxity) and x.protocol.name == FRAME:
            named += 1
            x = replace(x, protocol=replace(x.protocol, name=f"{FRAME}{named}"))
        found.append(x)
    return found


def _start(given: Any) -> Any:
    """Where fits start: values of an answer as a dictionary."""
    if isinstance(given, Answer) and given.parameter_set is not None:
        errors = {x.name for x in given.nuisances}
        return {name: x for name, x in given.parameter_set.items() if name not in errors}
    if given is None or isinstance(given, str | os.PathLike | Mapping):
        return given
    raise ValueRefused(
        f"{_shown(given)} is no start",
        "give subject, IG1 to IG4, a file ending in .toml or a dictionary of values by parameter, "
        "such as {'ACL.stiffness_kN': 9.5}",
    )


def _plain(given: Any, *, is_series: bool) -> Any:
    """Numbers of numpy as those of Python, also in a dictionary; a pandas series as one."""
    if is_series and hasattr(given, "to_dict") and hasattr(given, "index") and not is_frame(given):
        given = given.to_dict()
    if isinstance(given, Mapping):
        return {name: _plain(x, is_series=False) for name, x in given.items()}
    return given.item() if isinstance(given, np.generic) else given


def _names(name: str, given: Any, *, are_values: bool) -> Any:
    """Names as a sequence: one name as one of them, an array or an index of them as a list."""
    if isinstance(given, str):
        given = (given,)
    if given is None or (are_values and isinstance(given, Mapping)):
        return given
    at_start = name == FIXED
    if isinstance(given, Mapping) or not isinstance(given, Iterable):
        said = "values by name" if isinstance(given, Mapping) else repr(given)
        remedy = ", and their values as start={'ACL.stiffness_kN': 9.5}" if at_start else ""
        raise ValueRefused(f"{name} is {said}, and takes names alone", f"give a list{remedy}")
    names = list(given)
    if not_named := [x for x in names if not isinstance(x, str)]:
        wanted = "a dictionary of values by name" if are_values else "a list of names"
        raise ValueRefused(f"{name} has {not_named[0]!r}, which is no name", f"give {wanted}")
    if at_start and (valued := [x for x in names if "=" in x]):
        raise ValueRefused(
            f"--fix {valued[0]}: a parameter is held at its start",
            "give its name alone, and its value in a file of --start",
        )
    return given if isinstance(given, list | tuple) else [str(x) for x in names]


def _check_places(arguments: Mapping[str, Any]) -> None:
    """Refuse a table where the subject belongs, and a subject where the table does."""
    if SUBJECT not in arguments:
        return
    data = arguments.get(DATA)
    for one in data if isinstance(data, list | tuple) and data else [data]:
        _check_place(arguments, one)


def _check_place(arguments: Mapping[str, Any], data: Any) -> None:
    """The same for one of the tables."""
    subject = arguments[SUBJECT]
    if _is_protocol(subject):
        is_exchanged = _is_subject(arguments.get(PROTOCOL))
        raise ValueRefused(
            f"{_shown(subject)} is a protocol"
            + (
                ": subject and protocol have changed places"
                if is_exchanged
                else " where the subject belongs"
            ),
            "give the subject first, such as reference",
        )
    if _is_table(subject):
        if DATA in arguments and (data is None or _is_subject(data)):
            mistake = (
                "subject and data have changed places" if data is not None else "it is the data"
            )
            raise ValueRefused(f"{_shown(subject)} is a laxity table: {mistake}", ORDER)
        raise ValueRefused(
            f"{_shown(subject)} is a laxity table where the subject belongs",
            "give a subject folder, a Knee or a name such as reference",
        )
    if not isinstance(subject, Knee | str | os.PathLike):
        raise ValueRefused(
            f"{_shown(subject)} is no subject",
            "give a subject folder, a Knee or a name such as reference",
        )
    if data is not None and _is_subject(data):
        raise ValueRefused(f"{_shown(data)} is a subject where the laxity table belongs", ORDER)
    if _is_protocol(data):
        raise ValueRefused(
            f"{_shown(data)} is a protocol where the laxity table belongs",
            "give measured laxity"
            + (", or name it as the protocol" if PROTOCOL in arguments else ""),
        )
    if data is not None and not isinstance(data, Laxity):
        check_is_table(data)


def _is_table(given: Any) -> bool:
    """Whether this can only be laxity."""
    if isinstance(given, str | os.PathLike):
        path = Path(given)
        is_table = path.suffix.lower() in TABLE_FILES and not path.is_dir()
        return is_table or is_experiments(path)
    return isinstance(given, Laxity) or is_frame(given)


def _is_protocol(given: Any) -> bool:
    """Whether this can only be trials to make."""
    if isinstance(given, str):
        return given in BUILT_IN and not Path(given).exists()
    return isinstance(given, Protocol)


def _is_subject(given: Any) -> bool:
    """Whether this can only be a subject."""
    if not isinstance(given, str | os.PathLike):
        return isinstance(given, Knee)
    if given in TABLES:
        return False
    path = Path(given)
    is_toml = path.suffix.lower() in SUBJECT_FILES and not is_experiments(path)
    is_file = is_toml or (path / FILE).is_file()
    return is_file or named_subject(given) is not None


def _shown(given: Any) -> str:
    if isinstance(given, str | os.PathLike):
        return os.fspath(given)
    if isinstance(given, Protocol):
        return given.name
    if is_frame(given):
        return "the DataFrame"
    return f"the {type(given).__name__}"


def knee_digest(knee: Knee) -> str:
    """SHA-256 of all numbers of a knee, and of what it states to be uncertain."""
    parts = [knee.side.encode()]
    for x in knee.ligaments:
        numbers = (*x.femur.tolist(), *x.tibia.tolist(), x.stiffness_kN, x.reference_strain_pct)
        parts.append(f"{x.name} {numbers}".encode())
        if x.wrap is not None:
            vectors = [y is not None and y.tolist() for y in (x.wrap.axis, x.wrap.side)]
            own = (x.wrap.bone, x.wrap.centre.tolist(), float(x.wrap.radius_mm), vectors)
            parts.append(f"around {own}".encode())
    for effect in knee.effects:
        ends = [(femur.tolist(), tibia.tolist()) for femur, tibia in effect.lines]
        spread = (effect.stiffness_sd_kN, effect.site_sd_mm)
        parts.append(f"{effect.name} {dict(effect.values)} {effect.fixed} {ends} {spread}".encode())
    stated = (knee.uncertainty, sorted(knee.priors.items()), sorted(knee.bounds.items()))
    if stated != (EXACTLY, [], []):
        parts.append(repr(stated).encode())
    known = [(x.flexion_deg, x.coordinates.tolist()) for x in knee.poses]
    further = (knee.groups, known, sorted(knee.fitted.items()))
    if further != ((), [], []):
        parts.append(repr(further).encode())
    if across := knee.uncertainty.insertions_normal_mm:
        parts.append(f"across the bone {across}".encode())
        parts += [x.vertices.tobytes() for x in knee.bones or ()]
    if lacking := knee.uncertainty.structures:
        parts.append(f"structures {lacking}".encode())
    if knee.contact_rounding_mm:
        parts.append(f"contact rounding {knee.contact_rounding_mm}".encode())
    for surface in (knee.femur, *knee.tibia):
        parts += [surface.vertices.tobytes(), surface.faces.tobytes()]
    for frame in (knee.femur_frame, knee.tibia_frame):
        parts += [frame.origin.tobytes(), frame.axes.tobytes()]
    return digest(b"".join(parts))


WORK = "work.sqlite"
# What cannot change a number; everything else decides whether stored work may be resumed. Of
# subject and data the content decides, whatever they are called and wherever they stand.
NOT_DECIDING = frozenset({"out", "workers", "subject", "data"})
# The argument of a verb that takes results in place of a knee.
RESULTS = "results"
BESIDE, RECORDED = "__not_deciding__", "__recorded_as__"
# Files that a name is read from, and what a folder of results is known by.
TOML = ".toml"
READ, SUMMARY = (TOML, ".json", ".osim", ".csv", ".sto", ".mot"), "result.json"
# Kept by their names in the record of a call.
_NAMED = (Knee, Protocol, MechanicalEffect, ObservationEffect, Limit)
Arguments = ParamSpec("Arguments")
Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result", bound=Answer)
Given = TypeVar("Given", bound=Answer, covariant=True)


@dataclass(slots=True, kw_only=True)
class Run:
    """What a verb works with while it runs: its executor, its store and its clock.

    Attributes
    ----------
    workers
        Processes to work with.
    out
        Folder of the results; None where nothing is written.
    deciding
        All that the results depend on.
    trials
        The trials of the data that are asked about; None for a verb without data.
    priors_set_aside
        Parameters whose priors do not count, as the data contradict them.
    """

    workers: Workers
    out: Path | None
    deciding: Mapping[str, Any]
    trials: TrialsAsked | None = None
    priors_set_aside: tuple[str, ...] = ()
    _stack: ExitStack
    _executor: Executor | None = None
    _store: Store | None = None
    _began: float = 0.0

    @property
    def executor(self) -> Executor:
        """Anything with an ordered ``map``, its processes started when it is first asked for."""
        if self._executor is None:
            self._executor = self._stack.enter_context(executor_of(self.workers))
        return self._executor

    @property
    def store(self) -> Store | None:
        """Where unfinished work is kept, opened when first asked for; None without a folder."""
        if self._store is None and self.out is not None:
            self._store = self._stack.enter_context(open_work(self.out / WORK, self.deciding))
        return self._store

    def add_resume_condition(self, **values: Any) -> None:
        """Add to what stored work must agree with, before the store is opened."""
        self.deciding = {**self.deciding, **values}

    def start_clock(self) -> None:
        """Begin to count the time of the computation: all before is loading and compiling."""
        self._began = time.perf_counter()

    def finish(self) -> None:
        """Note that the results of the stored work are written."""
        if self.out is not None and self._store is not None:
            finish_work(self.out / WORK)

    @property
    def seconds(self) -> float:
        """Time since the clock was started, with that of the runs that were resumed."""
        earlier = 0.0 if self._store is None else self._store.earlier_s
        return earlier + time.perf_counter() - self._began


class OfData(TypedProtocol[Arguments, Given]):
    """A verb as users call it: with a knee and its laxity, or where to read them."""

    def __call__(
        self,
        subject: options.SubjectLike,
        data: options.LaxityLike,
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> Given:
        """The answer."""


class OfMaybeData(TypedProtocol[Arguments, Given]):
    """A verb as users call it: with a knee, and with its laxity or without."""

    def __call__(
        self,
        subject: options.SubjectLike,
        data: options.LaxityLike | None = None,
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> Given:
        """The answer."""


class OfSubject(TypedProtocol[Arguments, Given]):
    """A verb as users call it: with a knee alone, or where to read it."""

    def __call__(
        self, subject: options.SubjectLike, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Given:
        """The answer."""


@overload
def verb(
    function: Callable[Concatenate[Run, Knee, Laxity | None, Arguments], Result],
) -> OfMaybeData[Arguments, Result]: ...
@overload
def verb(
    function: Callable[Concatenate[Run, Knee, Laxity, Arguments], Result],
) -> OfData[Arguments, Result]: ...
@overload
def verb(
    function: Callable[Concatenate[Run, Knee, Arguments], Result],
) -> OfSubject[Arguments, Result]: ...
@overload
def verb(
    function: Callable[Concatenate[Run, Arguments], Result],
) -> Callable[Arguments, Result]: ...
def verb(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as users call it: without its run, and with files in place of what is in them.

    The function gets ``subject`` and ``data`` as they were read, the subject with its uncertainty
    as ``uncertain`` states it. The run has the folder ``out`` and the executor of ``workers``.
    Every other argument is part of what stored work must agree with to be resumed.
    """
    public = parameters_in_full(function)
    # The first parameter is the run, which the scaffold provides.
    del public[next(iter(public))]

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        bound = _bound(function, called, args, kwargs)
        bound.apply_defaults()
        bound.arguments.update(read_arguments(public, bound.arguments))
        with one_library_thread(), _run(function, bound.arguments) as (run, read, recording):
            run.start_clock()
            result = function(run, **bound.arguments | read)
            if run.trials is not None:
                asked = question(recording.verb, read["subject"], run.trials, bound.arguments)
                findings = _with_those_of_data(result.findings, run.trials.findings)
                asked = replace(asked, priors_set_aside=run.priors_set_aside)
                result = replace(result, question=asked, findings=findings)
            if warned := _subject_warnings(bound.arguments, read):
                result = replace(result, findings=without_repeats((*result.findings, *warned)))
            result = replace(result, seconds=run.seconds, record=recording.finish())
        if run.out is not None:
            # xarray takes longer to load than a short computation takes.
            from identknee.verbs.files import write_answer

            result = write_answer(run.out, result)
            run.finish()
        return result

    return explained(called, public)


def _with_those_of_data(
    found: tuple[Finding, ...], of_data: tuple[Finding, ...]
) -> tuple[Finding, ...]:
    """Findings of an answer and of its data; of what both say the answer knows more."""
    known = {(x.code, x.where) for x in found}
    rest = (x for x in of_data if (x.code, x.where) not in known)
    return without_repeats((*found, *rest))


def not_resume_relevant(*names: str) -> Callable[[Function], Function]:
    """Decorator, below ``@verb``, that names options which cannot change a number in the store.

    With another value of them the same work goes on, as with a larger budget.
    """

    def mark(function: Function) -> Function:
        setattr(function, BESIDE, frozenset(names))
        return function

    return mark


def recorded_as(name: str, *, secret: Sequence[str] = ()) -> Callable[[Function], Function]:
    """Decorator, below ``@verb``: the verb's name in its record, and arguments to leave out of it.

    Without it the name is that of the function, and every argument is recorded.
    """

    def mark(function: Function) -> Function:
        setattr(function, RECORDED, (name, frozenset(secret)))
        return function

    return mark


@contextmanager
def _run(
    function: Callable[..., Any], arguments: Mapping[str, Any]
) -> Iterator[tuple[Run, Mapping[str, Any], Any]]:
    """The run, the arguments that were read from files, and the recording."""
    name, secret = getattr(function, RECORDED, (function.__name__, frozenset()))
    beside = NOT_DECIDING | getattr(function, BESIDE, frozenset())
    out = arguments.get("out")
    folder = None if out is None else prepare_folder(out)
    data = arguments.get("data")
    laxity = given = None if data is None else read_experiments(data)
    if laxity is None and _needs_data(function):
        raise ValueError("there are no data; give a laxity table")
    subject = arguments.get("subject", options.REFERENCE)
    of_results = arguments.get(RESULTS)
    knee = subject if isinstance(subject, Knee) else read_subject(subject)
    if (stated := arguments.get("uncertain")) is not None:
        knee = knee.with_uncertainty(with_stated_uncertainty(knee.uncertainty, stated))
    if arguments.get("discrepancy") == STRUCTURES:
        arguments = {**arguments, "discrepancy": "none"}
        if not knee.uncertainty.structures:
            arguments["uncertain"] = _with_structures(stated)
            knee = knee.with_uncertainty(replace(knee.uncertainty, structures=1.0))
    knee = knee.with_plausibility(arguments.get("plausible"))
    asked = None
    if "leave_out" in arguments:
        named = {k: arguments[k] or () for k in ("keep", "leave_out")}
        if laxity is not None:
            noise = arguments.get("noise")
            stated_mm = None if noise is None else noise_of(noise)[0]
            asked = trials_asked(laxity, noise_mm=stated_mm, **named)
            laxity = asked.laxity
        elif any(named.values()):
            raise ValueError("--keep and --leave-out name trials of DATA.csv; give it")
    read = {k: x for k, x in (("subject", knee), ("data", laxity)) if k in arguments}
    inputs = _inputs(arguments, knee, given, data)
    if of_results is not None:
        # A verb of results is of their knees.
        inputs = result_digests(of_results)
    settings = {key: _setting(x) for key, x in arguments.items()}
    recorded = {key: x for key, x in settings.items() if key not in secret}
    recording = record(name, recorded, inputs, arguments.get("seed"))
    deciding = {key: x for key, x in settings.items() if key not in beside}
    workers = arguments.get("workers", 1)
    with ExitStack() as stack:
        run = Run(
            workers=workers,
            out=folder,
            deciding={"verb": name, "inputs": inputs, **deciding},
            trials=asked,
            _stack=stack,
        )
        yield run, read, recording


def _with_structures(stated: UncertainLike) -> UncertainLike:
    """What is stated as uncertain, and the structures that ``discrepancy="structures"`` means.

    Records say it so, since all verbs take it.
    """
    if isinstance(stated, Mapping):
        return {**stated, STRUCTURES: 1.0}
    texts = [stated] if isinstance(stated, str) else list(stated or ())
    return ",".join([*texts, f"{STRUCTURES}=100%"])


def _subject_warnings(arguments: Mapping[str, Any], read: Mapping[str, Any]) -> tuple[Finding, ...]:
    """What the check of the subject warns of, for verbs that load it.

    Of the knees that come with identknee there is nothing to warn of, which tests see to.
    """
    is_loaded = "data" in arguments or "protocol" in arguments
    if "subject" not in read or not is_loaded or named_subject(arguments["subject"]) is not None:
        return ()
    return geometry_warnings(read["subject"])


def _needs_data(function: Callable[..., Any]) -> bool:
    data = inspect.signature(function).parameters.get("data")
    return data is not None and data.default is data.empty


def _inputs(
    arguments: Mapping[str, Any], knee: Knee, laxity: Laxity | None, data: Any
) -> dict[str, str]:
    """SHA-256 of everything that came from outside the call."""
    inputs = {"subject": knee_digest(knee)}
    if knee.plausibility:
        inputs["plausibility"] = digest(repr(knee.plausibility).encode())
    is_one_file = isinstance(data, str | Path) and Path(data).suffix.lower() != TOML
    if laxity is not None:
        inputs["data"] = digest(laxity_file(data)) if is_one_file else laxity_digest(laxity)
    others = {k: x for k, x in arguments.items() if k not in ("subject", "data", "out")}
    inputs |= {k: _protocol_digest(x) for k, x in others.items() if isinstance(x, Protocol)}
    inputs |= {k: laxity_digest(x) for k, x in others.items() if isinstance(x, Laxity)}
    read = {k: path for k, x in others.items() if (path := _file_of(x)) is not None}
    return inputs | {k: digest(path) for k, path in read.items()}


def result_digests(results: Sequence[Any] | Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of every file of results in the folders given, by their place."""
    given = results.values() if isinstance(results, Mapping) else results
    folders = {k: x for k, x in enumerate(given, 1) if isinstance(x, str | Path)}
    return {
        f"{RESULTS} {k}": digest(b"".join(x.read_bytes() for x in _summaries(Path(folder))))
        for k, folder in folders.items()
    }


def _summaries(folder: Path) -> list[Path]:
    return [folder] if folder.is_file() else sorted(folder.rglob(SUMMARY))


def _file_of(value: Any) -> Path | None:
    """The file that an argument is read from; of a folder of results, that with its digests."""
    if isinstance(value, Path) and value.is_dir():
        value = value / SUMMARY
    is_path = isinstance(value, str | Path) and Path(value).suffix in READ
    return Path(value) if is_path and Path(value).is_file() else None


def laxity_digest(laxity: Laxity) -> str:
    """SHA-256 of all numbers of a laxity table."""
    numbers = [laxity.coordinates, laxity.sd, laxity.order]
    words: tuple[Any, ...] = (laxity.zero, laxity.within_trial_correlation, laxity.phase)
    if laxity.forces is not None:
        words = (*words, laxity.forces.names)
        numbers += [laxity.forces.values, laxity.forces.sd]
    if (made := laxity.superposition) is not None:
        words = (*words, made.trials, made.cut, made.before, made.after)
        numbers += [made.values, made.sd, made.pose_sd]
    parts = [b"" if x is None else x.tobytes() for x in numbers]
    return digest(
        b"".join([_protocol_digest(laxity.protocol).encode(), repr(words).encode(), *parts])
    )


def _protocol_digest(protocol: Protocol) -> str:
    words: tuple[Any, ...] = (protocol.name, protocol.trials)
    if protocol.state or protocol.experiment:
        words = (*words, protocol.state, protocol.experiment, protocol.experiments)
    return digest(repr(words).encode() + protocol.flexion_deg.tobytes() + protocol.loads.tobytes())


def _setting(value: Any) -> Any:
    """An argument as the record keeps it: a knee or effects by name, else by what it is."""
    if isinstance(value, Answer):
        return f"a {type(value).__name__} in memory"
    if isinstance(value, _NAMED):
        return value.name
    kept = (*_NAMED, Laxity, Answer)
    if isinstance(value, list | tuple) and any(isinstance(x, kept) for x in value):
        return [_setting(x) for x in value]
    if isinstance(value, Mapping) and any(isinstance(x, kept) for x in value.values()):
        return {name: _setting(x) for name, x in value.items()}
    return "a table in memory" if isinstance(value, Laxity) else value


def warm_up(knee: Knee, protocol: Protocol) -> None:
    """Compile and build the distance field, or load them, so that times taken later exclude it."""
    with progress_bar("preparing, longer the first time after an installation"):
        model = LaxityModel(knee=knee, protocol=protocol.select([0]), effects=())
        model.predict(model.parameters.center)
