"""How the report shows answers: one presenter per class, found by the name of the class.

Nothing here imports figures or other verbs, so that a terminal prints an answer at once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum, unique
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from identknee.laxity.protocol import Protocol
from identknee.report.tables import Table
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding, doubt_of
from identknee.runs.words import listed
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from identknee.report.laxity_figures import LaxityCurves

# Most trials that are listed by name.
MOST_NAMED = 8


def assumption_sentences(answer: Answer) -> tuple[str, ...]:
    """The assumptions of an answer, as sentences."""
    trials = answer.trials_used
    if not trials:
        return answer.assumptions
    names = f": {listed(trials)}" if len(trials) <= MOST_NAMED else ""
    many = "1 measured trial" if len(trials) == 1 else f"{len(trials)} measured trials"
    return (f"The result rests on {many}{names}.", *answer.assumptions)


@unique
class Question(Enum):
    """Parts of the page by the question they answer, in their order; the value is the anchor."""

    KNOWN = "known"
    WRONG = "wrong"
    NEXT = "next"
    LAXITY = "laxity"
    SEARCH = "search"

    @property
    def heading(self) -> str:
        """Heading of the part on the page."""
        return _HEADINGS[self]


_HEADINGS = {
    Question.KNOWN: "What is known, and what is not",
    Question.WRONG: "What the model gets wrong, and why",
    Question.NEXT: "Which test to do next",
    Question.LAXITY: "Measured and simulated laxity",
    Question.SEARCH: "How the parameters were searched for",
}


@declared
class Statement:
    """A sentence with its tables and figures."""

    question: Question = entry("What it answers")
    sentence: str = entry("One or a few whole sentences")
    tables: tuple[Table, ...] = entry("The numbers behind it", default=())
    is_answer: bool = entry("Whether it leads its part of the page", default=False)
    warning: Finding | None = entry(
        "The warning that the sentence states, if it is one; it leads the page",
        default=None,
    )


@declared
class Drawing:
    """A figure with what stands below it and what is said in its place."""

    name: str = entry("Name of its file, without an ending")
    figure: "Figure" = entry("The figure")
    caption: str = entry("How to read it")
    description: str = entry("What it shows, for those who do not see it")


# Of a normal distribution, half of its central 95 %.
SDS_95 = 1.96
NOT_CONVERGED = "not converged"
CLOSED, BY_ASSUMPTION = "known", "bounded by assumption"


@unique
class Source(Enum):
    """A method, the most informative first; the value is its name in a sentence."""

    PROFILE = "profile"
    POSTERIOR = "posterior"
    DIAGNOSIS = "diagnosis"
    CAUSE = "diagnosis with the cause"
    INFORMATION = "local approximation"
    EQUIVALENTS = "equivalent set"


@declared
class Range:
    """What one method says of one quantity."""

    source: Source = entry("The method")
    low: float | None = entry("Lower end of its 95 % set or range; None where open")
    high: float | None = entry("Upper end; None where open")
    value: float | None = entry("Its estimate; None where it has none")
    status: str = entry("What is known, in a word or three")
    # A range of another limit is scaled by its root before it is compared.
    reach: float | None = entry(
        "Limit of the squared misfit that it stands for, over the one of a 95 % set; None where "
        "the two cannot be compared",
        default=1.0,
    )

    @property
    def is_closed(self) -> bool:
        """Whether it has both ends."""
        return self.low is not None and self.high is not None

    @property
    def width(self) -> float:
        """From end to end; infinite where one is open."""
        if self.low is None or self.high is None:
            return float("inf")
        return self.high - self.low


def open_ends_text(low: float | None, high: float | None) -> str:
    """Which ends of a range are open.

    Examples
    --------
    >>> open_ends_text(1.0, 2.0), open_ends_text(1.0, None), open_ends_text(None, None)
    ('known', 'open above', 'not known')
    """
    if low is None:
        return "not known" if high is None else "open below"
    return "open above" if high is None else CLOSED


Given = TypeVar("Given", bound=Answer)
# Laxity of all that fits as well: its name, shape ``(n, trial, 5)``, and the quantiles of its ends.
Band = tuple[str, Array, tuple[float, float]]
# The module of `identknee.report.answers` and the presenter there, by the class of the answer.
PRESENTERS = {
    "Demonstration": "demo:DemonstrationPresenter",
    "Simulation": "simulate:SimulationPresenter",
    "Calibration": "fit:CalibrationPresenter",
    "Sweep": "sweep:SweepPresenter",
    "Profiles": "profile:ProfilesPresenter",
    "Sample": "sample:SamplePresenter",
    "LocalIdentifiability": "information:InformationPresenter",
    "Equivalents": "equivalents:EquivalentsPresenter",
    "GlobalSensitivity": "sensitivity:SensitivityPresenter",
    "Diagnosis": "diagnose:DiagnosisPresenter",
    "Isolability": "diagnose:IsolabilityPresenter",
    "Design": "design:DesignPresenter",
    "Comparison": "compare:ComparisonPresenter",
    "SubjectFacts": "subject:SubjectPresenter",
    "ImportedSubject": "subject:ImportedSubjectPresenter",
    "SubjectCheck": "subject:SubjectCheckPresenter",
    "SettledSubject": "subject:SettledSubjectPresenter",
}


class Presenter(Generic[Given]):
    """How answers of one class are shown; methods that are not overridden show nothing.

    Attributes
    ----------
    question
        The part of the page where their figures stand, and what `say` says.
    questions
        Figures that stand elsewhere, by their names.
    is_folded
        Whether all their figures are one click away.
    is_brief
        Whether all that they say is the answer, so that a command prints it all.
    """

    question: ClassVar[Question] = Question.KNOWN
    questions: ClassVar[Mapping[str, Question]] = {}
    is_folded: ClassVar[bool] = False
    is_brief: ClassVar[bool] = False

    def statements(self, answer: Given) -> Iterator[Statement]:
        """What the answer says, its main sentence first."""
        raise NotImplementedError

    def say(self, sentence: str, *tables: Table, is_answer: bool = False) -> Statement:
        """A statement in the part of the page where such answers stand."""
        return Statement(
            question=self.question, sentence=sentence, tables=tables, is_answer=is_answer
        )

    def drawings(self, _answer: Given, _subject: str, _knee: Knee | None) -> Iterator[Drawing]:
        """All figures, the most informative first, with name and knee of the subject if known."""
        yield from ()

    def curves(self, _answer: Given, _beside: Sequence[Answer]) -> "LaxityCurves | None":
        """Measured and simulated laxity, with what other answers say of the same data."""
        return None

    def band(self, _answer: Given) -> Band | None:
        """Laxity of all that fits as well."""
        return None

    def pictures(self, _answer: Given, _knee: Knee) -> dict[str, "Figure"]:
        """Figures that the command leaves beside the results, by the names of their files."""
        return {}

    def ranges(self, _answer: Given) -> Iterator[tuple[str, Range]]:
        """Each parameter and force by its name, with what the answer says of it."""
        yield from ()

    def doubt(self, answer: Given, _source: Source) -> str | None:
        """Why values of the answer do not count as known, in words; None where they may."""
        found = doubt_of(answer.findings)
        return None if found is None else found.value

    def next_tests(self, answer: Given) -> Iterator[str]:
        """Advised tests, and what each would bring."""
        for x in self.statements(answer):
            if x.is_answer and x.question is Question.NEXT:
                yield x.sentence

    def headline(self, _answer: Given) -> str:
        """A sentence that leads the page; empty for most answers."""
        return ""

    def protocol(self, _answer: Given) -> Protocol | None:
        """The trials; None if the answer keeps none."""
        return None

    def missing_line(self, _answer: Given, _knee: Knee) -> Array | None:
        """Ends of a missing line of action in the common frame [mm]; None if there is none."""
        return None

    def method(self, _answer: Given) -> Iterator[str]:
        """How it was computed, as sentences for a paper that say no more than its record."""
        yield from ()

    def sources(self, _answer: Given) -> tuple[str, ...]:
        """What a paper that uses the answer should cite for its method."""
        return ()

    def joined(self, _first: Given, _later: Given) -> Given | None:
        """Two answers from the same data merged into one; None if they are shown separately."""
        return None


BOX = "Box (1965), Comput. J. 8(1), 42-52, doi:10.1093/comjnl/8.1.42"


def settings_of(answer: Answer) -> Mapping[str, Any]:
    """The settings of the call that made the answer; none where its record is not known."""
    return {} if answer.record is None else answer.record.settings


def optimizer_sources(method: str) -> tuple[str, ...]:
    """What to cite for an optimizer."""
    return (BOX,) if method == "complex" else ()


def presenter_of(answer: Answer) -> Presenter[Any]:
    """The presenter of an answer."""
    place = PRESENTERS[type(answer).__name__]
    presenter: type[Presenter[Any]] = resolve_name(f"identknee.report.answers.{place}")
    return presenter()


def statements_of(answer: Answer) -> tuple[Statement, ...]:
    """What an answer says, its main sentence first."""
    return tuple(presenter_of(answer).statements(answer))


def main_statements(answer: Answer) -> tuple[Statement, ...]:
    """What belongs at the head of a page; of an answer without it the first statement."""
    said = statements_of(answer)
    return tuple(x for x in said if x.is_answer) or said[:1]


def of_type(answers: Iterable[Answer], kind: type[Given]) -> list[Given]:
    """Those of the answers that are of this class."""
    return [x for x in answers if isinstance(x, kind)]
