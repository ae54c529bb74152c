"""How the report shows answers: one presenter a class of answers, found by the name of the class.

Nothing here loads figures or the answers of other verbs: a terminal prints what it has at once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from identknee.laxity.protocol import Protocol
from identknee.report.statement import Question, Statement
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from identknee.report.drawing import Drawing
    from identknee.report.laxity_figures import LaxityCurves
    from identknee.report.range import Range

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
    "Isolability": "isolability:IsolabilityPresenter",
    "Design": "design:DesignPresenter",
    "SubjectFacts": "subject:SubjectPresenter",
    "SubjectCheck": "subject:SubjectCheckPresenter",
    "SettledSubject": "subject:SettledSubjectPresenter",
}


class Presenter(Generic[Given]):
    """How answers of one class are shown; what they have nothing of is left as it is here.

    Attributes
    ----------
    question
        The part of the page where their figures stand.
    questions
        Figures that stand elsewhere, by their names.
    is_folded
        Whether all their figures are one click away.
    """

    question: ClassVar[Question] = Question.KNOWN
    questions: ClassVar[Mapping[str, Question]] = {}
    is_folded: ClassVar[bool] = False

    def statements(self, answer: Given) -> Iterator[Statement]:
        """What the answer says, its main sentence first."""
        raise NotImplementedError

    def drawings(self, _answer: Given, _subject: str, _knee: Knee | None) -> Iterator["Drawing"]:
        """All figures, the most telling first, with name and knee of the subject if known."""
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

    def ranges(self, _answer: Given) -> Iterator[tuple[str, "Range"]]:
        """Parameters and forces, by its name."""
        yield from ()

    def next_tests(self, _answer: Given) -> Iterator[str]:
        """Advised tests, and what each would bring."""
        yield from ()

    def headline(self, _answer: Given) -> str:
        """What comes before everything else that results say together; mostly nothing."""
        return ""

    def protocol(self, _answer: Given) -> Protocol | None:
        """The trials; None if the answer keeps none."""
        return None

    def missing_line(self, _answer: Given, _knee: Knee) -> Array | None:
        """Ends of a missing line of action in the common frame [mm]; None if there is none."""
        return None

    def joined(self, _first: Given, _later: Given) -> Given | None:
        """Two answers from the same data as one; None if they stand side by side."""
        return None


def presenter_of(answer: Answer) -> Presenter[Any]:
    """What shows the answer."""
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
