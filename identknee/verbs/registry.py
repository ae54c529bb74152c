"""All verbs, each with what the command line, the result files and the report know of it.

This module imports no verb: a verb is imported when it is called.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Verb:
    """A function that gives an answer, and the command of the same name.

    Attributes
    ----------
    name
        Name in records and on the command line, there with its group: ``"subject check"``.
    module
        Module of the function, if not named after the verb.
    function
        Name of the function, if not that of the verb.
    answer
        Name of the class of its answer, which its module knows.
    summary
        One line of help; empty if the verb has no command.
    example
        What follows the name in the example of its help.
    folder
        Default of ``--out`` on the command line, if not named after the verb.
    resumes
        Whether a stopped run resumes.
    is_reported
        Whether the report takes its results.
    suggestion
        The question with which the report suggests the verb where it was not run yet.
    has_pictures
        Whether the command writes pictures beside the results.
    parameter_rank
        Of several results that each hold a parameter set, the set of the highest rank counts.
    then
        What to do next, with ``{out}`` for the folder of the results.
    beginning
        What the command says before it computes, with options by their names in braces.
    has_page
        Whether the command writes the report too.
    """

    name: str
    answer: str
    module: str = ""
    function: str = ""
    summary: str = ""
    example: str = ""
    folder: str = ""
    resumes: bool = False
    is_reported: bool = False
    suggestion: str = ""
    has_pictures: bool = False
    parameter_rank: int = 0
    then: str = ""
    beginning: str = ""
    has_page: bool = False

    def __post_init__(self) -> None:
        usual = {
            "module": f"identknee.verbs.{self.name}",
            "function": self.name,
            "folder": f"identknee-{self.name}",
        }
        for key, value in usual.items():
            object.__setattr__(self, key, getattr(self, key) or value)

    @property
    def call(self) -> Callable[..., Any]:
        """The function, loaded with its module."""
        function: Callable[..., Any] = resolve_name(f"{self.module}:{self.function}")
        return function

    @property
    def answer_class(self) -> Any:
        """The class of its answer, loaded with its module."""
        return resolve_name(f"{self.module}:{self.answer}")


# In the order of the flow: the report and the help list them so.
_VERBS = [
    Verb(
        name="demo",
        answer="Demonstration",
        summary="Ask the paper's question, and answer it in about a minute.",
        example="--out story",
        beginning="Reference knee, 63 trials, noise-free. Short settings.\n"
        "Fitting from the paper's four starts: Complex ({runs} runs each), least squares. Then "
        "profiles from noisy data.",
        has_page=True,
        is_reported=True,
        has_pictures=True,
    ),
    Verb(
        name="simulate",
        answer="Simulation",
        summary="Simulate laxity tests of SUBJECT.",
        example="reference --noise 0.5mm,0.5deg --out knee",
        is_reported=True,
        parameter_rank=1,
    ),
    Verb(
        name="fit",
        answer="Calibration",
        summary="Fit the parameters of SUBJECT to DATA.csv.",
        example="reference data.csv --start IG4",
        is_reported=True,
        suggestion="Which parameters reproduce this laxity?",
        parameter_rank=3,
    ),
    Verb(
        name="sweep",
        answer="Sweep",
        summary="Fit from many starts, and see what stopped each search.",
        example="reference data.csv --n-starts 200 --workers 2",
        resumes=True,
        is_reported=True,
        suggestion="Do other starts end elsewhere?",
    ),
    Verb(
        name="profile",
        answer="Profiles",
        summary="Find which values of each parameter the data allow.",
        example="reference data.csv --parameter ACL.stiffness_kN",
        resumes=True,
        is_reported=True,
        suggestion="Which parameters are bounded, and within what limits?",
        parameter_rank=2,
    ),
    Verb(
        name="sample",
        answer="Sample",
        summary="Sample the posterior of the parameters given the data.",
        example="reference data.csv --workers 2",
        resumes=True,
        is_reported=True,
        suggestion="How probable is each value, and each ligament force?",
    ),
    Verb(
        name="information",
        answer="LocalIdentifiability",
        summary="Find which parameter combinations the data determine.",
        example="reference data.csv --noise 0.5mm,0.5deg",
        is_reported=True,
        suggestion="Which combinations of parameters do the data determine?",
    ),
    Verb(
        name="equivalents",
        answer="Equivalents",
        summary="Find other parameter sets that the data cannot distinguish.",
        example="reference data.csv --criterion paper",
        resumes=True,
        is_reported=True,
        suggestion="How different are knees that this measurement cannot distinguish?",
    ),
    Verb(
        name="sensitivity",
        answer="GlobalSensitivity",
        summary="Find which parameters the laxity of a knee depends on.",
        example="reference --method morris --workers 2",
        resumes=True,
        is_reported=True,
        suggestion="Which parameter moves which laxity?",
    ),
    Verb(
        name="diagnose",
        answer="Diagnosis",
        summary="Find what the model of SUBJECT gets wrong, and why.",
        example="reference data.csv --noise 0.3mm,0.3deg",
        is_reported=True,
        suggestion="What does the model get wrong, and why?",
        has_pictures=True,
    ),
    # Of a protocol instead of data, on the command line by `diagnose` too.
    Verb(name="isolability", answer="Isolability", is_reported=True),
    Verb(
        name="design",
        answer="Design",
        summary="Choose the trials that would best close what is still open.",
        example="reference data.csv --target ACL.stiffness_kN",
        is_reported=True,
        suggestion="Which trials would close the gap?",
    ),
    Verb(
        name="subject check",
        module="identknee.verbs.subject",
        function="check_subject",
        answer="SubjectCheck",
        summary="Check SUBJECT, and whether its trials are stable.",
        example="my-knee",
        folder="identknee-check",
    ),
    Verb(
        name="subject settle",
        module="identknee.verbs.subject",
        function="settle_subject",
        answer="SettledSubject",
        summary="Move the insertions of SUBJECT until all trials are stable.",
        example="lenhart2015 --within 5 --out my-knee",
        folder="identknee-settled",
        then="Next: identknee subject check {out}",
    ),
    Verb(
        name="subject show",
        module="identknee.verbs.subject",
        function="describe_subject",
        answer="SubjectFacts",
        summary="Draw SUBJECT in its scanned pose.",
        example="reference --out picture",
        folder="identknee-show",
        has_pictures=True,
    ),
    Verb(
        name="subject import-osim",
        module="identknee.verbs.subject",
        function="import_subject",
        answer="ImportedSubject",
        summary="Turn an OpenSim model into a subject folder.",
        example="model.osim --out knee",
        folder="identknee-subject",
        then="Next: identknee subject check {out}",
    ),
]


def register(verb: Verb) -> None:
    """Add a verb that is defined in a higher layer than this package."""
    if all(x.name != verb.name for x in _VERBS):
        _VERBS.append(verb)


def verbs() -> tuple[Verb, ...]:
    """All verbs, in the order of the flow."""
    return tuple(_VERBS)


def verb_named(name: object) -> Verb | None:
    """The verb of this name in records; None if there is none."""
    return next((x for x in _VERBS if x.name == name), None)


def verbs_with_answer(name: str) -> Iterator[Verb]:
    """Verbs whose answer is of the class of this name."""
    return (x for x in _VERBS if x.answer == name)
