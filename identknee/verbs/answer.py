"""The fields common to all answers: findings, assumptions and provenance."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from typing_extensions import override

from identknee.calibrate.problem import EvidenceTerm
from identknee.identify.optimum import NuisanceEstimate
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding, invalidating
from identknee.runs.record import Record
from identknee.subject.knee import Knee
from identknee.verbs.printer import Printer, printer
from identknee.verbs.question import Question

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase
    from pandas import DataFrame


@declared
class Answer:
    """The result of a verb: printed as sentences and tables, drawn in a notebook."""

    seconds: float = entry("Time taken, without loading and compiling", unit="s", default=0.0)
    trials_used: tuple[str, ...] = entry(
        "Measured trials that the result rests on", only="measured data", default=()
    )
    assumptions: tuple[str, ...] = entry("Assumptions, as sentences", default=())
    uncertainty: Mapping[str, str] = entry(
        "What of knee and tests was taken as uncertain, by how much, and what as exact",
        default_factory=dict,
    )
    nuisances: tuple[NuisanceEstimate, ...] = entry(
        "What was taken as uncertain, as the best fit leaves it", default=()
    )
    question: Question | None = entry(
        "What was asked of the data: trials, noise, priors, bounds",
        only="measured data",
        default=None,
    )
    evidence: tuple[EvidenceTerm, ...] = entry(
        "Terms of the deviance at the best fit", only="measured data", default=()
    )
    findings: tuple[Finding, ...] = entry("Findings: warnings about the result", default=())
    record: Record | None = entry(
        "The call, its inputs, seed, versions and time; only what a verb gave back has one",
        default=None,
    )

    @property
    def failure(self) -> str:
        """Why nothing could be computed, or why nothing computed holds; empty elsewhere."""
        return invalidating(self.findings)

    @property
    def best_deviance(self) -> float:
        """Deviance of the best fit that the answer rests on; infinite where it has none."""
        return sum(x.deviance for x in self.evidence) if self.evidence else float("inf")

    @property
    def remark(self) -> str:
        """What only who runs the command has to know; empty for nothing."""
        return ""

    @property
    def parameter_set(self) -> Mapping[str, float] | None:
        """The parameters found or simulated with, by name; None if the answer holds no one set."""
        return None

    def plot(
        self,
        name: str | None = None,
        *,
        ax: "Axes | FigureBase | None" = None,
        width_mm: float | None = None,
        knee: Knee | None = None,
    ) -> "Figure":
        """A figure of the result, which a notebook shows as a picture.

        Colours and letters are those of the matplotlib style in use. In SVG and PDF text stays
        text.

        Parameters
        ----------
        name
            Which of its figures, such as ``"profiles"``; the most telling one if None.
        ax
            Where to draw it: axes, for figures of one panel, or a subfigure; a figure of its own
            if None.
        width_mm
            Width of the figure, such as 89 or 183 for one or two columns of a journal.
        knee
            The subject, for figures that show it; read by its name if None.

        Raises
        ------
        ValueError
            If the result has no figure, or none of that name; the message lists those it has. If
            it has several panels and `ax` is one, its texts do not fit into the width, or the knee
            is not the one of the result.
        """
        return self._printer.figure(self, name, ax=ax, width_mm=width_mm, knee=knee)

    def to_dataframe(self, table: str | None = None) -> "DataFrame":
        """A table of the result as a pandas ``DataFrame``, its columns with units.

        Parameters
        ----------
        table
            Which of its tables, such as ``"estimates"`` or ``"fitted-parameters"``; the first one
            if None.

        Raises
        ------
        ValueError
            If the result has no table, or none of that name; the message lists those it has.
        """
        return self._printer.dataframe(self, table)

    def methods(self) -> str:
        """How the result was computed, as a paragraph for a paper with its references.

        It says what the record of the result says, and nothing else.

        Raises
        ------
        ValueError
            If the result has no record, as one that no verb gave back.
        """
        return self._printer.methods(self)

    @property
    def _printer(self) -> Printer:
        if (shown_by := printer()) is None:
            raise ValueError("nothing here draws or shows answers; import identknee")
        return shown_by

    @override
    def __repr__(self) -> str:
        """What the result says, on at most 25 lines."""
        return _shown(lambda x: x.short_text(self), type(self).__name__)

    @override
    def __str__(self) -> str:
        """All that the result says, as a command prints it with ``--verbose``."""
        return _shown(lambda x: x.full_text(self), type(self).__name__)

    def brief(self) -> str:
        """What a command prints: the answer, its table and at most three findings."""
        return _shown(lambda x: x.brief_text(self), type(self).__name__)

    def _repr_html_(self) -> str:
        """The result in a notebook: its sentences, its table and one figure."""
        return _shown(lambda x: x.html(self), type(self).__name__)


def _shown(show: Callable[[Printer], str], otherwise: str) -> str:
    """What the printer makes of an answer; without one its class alone."""
    shown_by = printer()
    return otherwise if shown_by is None else show(shown_by)
