"""The fields common to all answers: what was asked, findings, assumptions and provenance.

Two answers can be compared where they were asked the same; where not, `Question.differences` says
in what.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from typing_extensions import override

from identknee.calibrate.problem import EvidenceTerm
from identknee.checks.left_out_trials import TrialsAsked
from identknee.identify.optimum import NuisanceEstimate
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding, invalidating
from identknee.runs.record import Record
from identknee.subject.knee import Knee
from identknee.verbs.printer import Printer, printer
from identknee.verbs.values import bounds_of, discrepancy_of, noise_of

# Verbs that weigh probabilities, which need a density of every parameter; others ask the data
# alone. Written here once for all.
WITH_PRIORS = frozenset({"sample", "diagnose"})
# Shares of a standard deviation that are no other noise.
ALIKE = 1e-6
# What two questions can differ in.
IN_WORDS = {
    "trials": "trials",
    "weighting": "weighting",
    "noise_mm": "noise of lengths",
    "noise_deg": "noise of angles",
    "priors": "priors of ligament parameters",
    "fixed": "fixed parameters",
    "bounds": "bounds",
    "uncertainty": "uncertainty of knee and tests",
    "plausibility": "limits of plausibility",
    "discrepancy": "error of the model that is marginalised",
    "priors_set_aside": "priors that do not count, as the data contradict them",
}


@declared
class Question:
    """What an answer is an answer to, beside the knee and the data."""

    trials: tuple[str, ...] = entry("Trials with measured values that were asked about")
    left_out_by_name: tuple[str, ...] = entry("Trials left out because they were named")
    contradicted: tuple[str, ...] = entry("Trials left out because the table contradicts them")
    weighting: str = entry(
        "Unit of the residuals: noise (stated), estimated (a noise found from the fit), or unit "
        "(1 mm and 1 deg)"
    )
    noise_mm: float | None = entry(
        "Standard deviation of lengths, the median of those stated; null where none is", unit="mm"
    )
    noise_deg: float | None = entry(
        "Standard deviation of angles, the median of those stated", unit="deg"
    )
    priors: bool = entry("Whether the priors of ligament parameters count")
    fixed: tuple[str, ...] = entry("Parameters held at the start")
    bounds: Mapping[str, tuple[float, float]] = entry("Bounds that were stated, by parameter")
    uncertainty: Mapping[str, str] = entry("What of knee and tests was taken as uncertain")
    plausibility: tuple[str, ...] = entry("Limits of plausibility that count", default=())
    discrepancy: tuple[float, float] | None = entry(
        "Scales of the prior of a smooth error of the model [mm, deg]; null where it has none",
        default=None,
    )
    priors_set_aside: tuple[str, ...] = entry(
        "Parameters whose priors do not count, as the data contradict them", default=()
    )

    def differences(self, other: "Question") -> tuple[str, ...]:
        """In what another question differs, in words; empty where both ask the same."""
        return tuple(
            words
            for name, words in IN_WORDS.items()
            if not _is_alike(getattr(self, name), getattr(other, name))
        )

    @property
    def words(self) -> dict[str, str]:
        """What was asked in words, part by part as `differences` names them."""
        sizes = ((self.noise_mm, "mm"), (self.noise_deg, "deg"))
        mm, deg = ("not stated" if x is None else f"{x:.3g} {unit}" for x, unit in sizes)
        bounds = [f"{name} {low:g} to {high:g}" for name, (low, high) in self.bounds.items()]
        uncertain = [f"{name} {x}" for name, x in self.uncertainty.items() if x != "exact"]
        left = len(self.left_out_by_name) + len(self.contradicted)
        return {
            IN_WORDS["trials"]: f"{len(self.trials)}{f', {left} left out' if left else ''}",
            IN_WORDS["weighting"]: self.weighting,
            IN_WORDS["noise_mm"]: mm,
            IN_WORDS["noise_deg"]: deg,
            IN_WORDS["priors"]: "yes" if self.priors else "no",
            IN_WORDS["fixed"]: ", ".join(self.fixed) or "none",
            IN_WORDS["bounds"]: ", ".join(bounds) or "as usual",
            IN_WORDS["uncertainty"]: ", ".join(uncertain) or "none",
            IN_WORDS["plausibility"]: ", ".join(self.plausibility) or "none",
            IN_WORDS["priors_set_aside"]: ", ".join(self.priors_set_aside) or "none",
        }


def question(verb: str, knee: Knee, asked: TrialsAsked, arguments: Mapping[str, Any]) -> Question:
    """The question that the arguments of a verb ask of a knee and of trials."""
    laxity = asked.laxity
    weighting = _weighting(knee, laxity, arguments)
    mm, deg = _noise(laxity, arguments.get("noise"))
    priors = arguments.get("priors")
    return Question(
        trials=tuple(np.array(laxity.protocol.trials, object)[laxity.is_measured.any(axis=1)]),
        left_out_by_name=asked.by_name,
        contradicted=asked.contradicted,
        weighting=weighting,
        noise_mm=mm if weighting == "noise" else None,
        noise_deg=deg if weighting == "noise" else None,
        priors=has_priors(verb, priors),
        fixed=tuple(arguments.get("fixed") or ()),
        bounds={**knee.bounds, **bounds_of(arguments.get("bounds"))},
        uncertainty=knee.uncertainty.words,
        plausibility=tuple(x.name for x in knee.counted_limits),
        discrepancy=discrepancy_of(arguments.get("discrepancy", "none")),
    )


def has_priors(verb: str, asked: bool | None) -> bool:  # noqa: FBT001 - as the option has it
    """Whether priors of ligament parameters count: as asked, or as the verb has it by default."""
    return verb in WITH_PRIORS if asked is None else asked


def _weighting(knee: Knee, laxity: Laxity, arguments: Mapping[str, Any]) -> str:
    has_more = laxity.has_forces or bool(knee.plausibility)
    if (has_more and laxity.sd is not None) or arguments.get("noise") is not None:
        return "noise"
    if "weighting" in arguments:
        return str(arguments["weighting"])
    return "estimated" if laxity.sd is None else "noise"


def _noise(laxity: Laxity, noise: Any) -> Sequence[float | None]:
    """Standard deviations of lengths and angles [mm, deg], where they are stated."""
    if noise is not None:
        return noise_of(noise)
    if laxity.sd is None:
        return None, None
    parts = (laxity.sd[:, x] for x in (TRANSLATIONS, ROTATIONS))
    known = (x[~np.isnan(x)] for x in parts)
    return [float(np.median(x)) if x.size else None for x in known]


def _is_alike(value: Any, other: Any) -> bool:
    if isinstance(value, float) and isinstance(other, float):
        return abs(value - other) <= ALIKE * abs(value)
    return bool(value == other)


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
        return _shown(lambda x: "\n".join(x.terminal_lines(self)), type(self).__name__)

    def brief(self) -> str:
        """What a command prints: the answer, its table and at most three findings."""
        return _shown(lambda x: "\n".join(x.brief_lines(self)), type(self).__name__)

    def _repr_html_(self) -> str:
        """The result in a notebook: its sentences, its table and one figure."""
        return _shown(lambda x: x.html(self), type(self).__name__)


def _shown(show: Callable[[Printer], str], otherwise: str) -> str:
    """What the printer makes of an answer; without one its class alone."""
    shown_by = printer()
    return otherwise if shown_by is None else show(shown_by)
