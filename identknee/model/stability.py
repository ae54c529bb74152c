"""How well posed a subject is: its margin over a protocol, over a box of parameters, by contact."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS
from identknee.model.insertion_moves import ENOUGH_MARGIN, WITHIN, InsertionMove, rank_moves
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array, frozen
from identknee.runs.executors import Executor, serial
from identknee.runs.outcome import Outcome
from identknee.runs.progress import progress
from identknee.subject.check import GeometryFinding

STIFFNESS_SHARE = 0.5
STRAIN_PCT = 3.0
# Trials and moves that a sentence lists.
MOST_LISTED = 4
ENOUGH_CONVERGED = 0.99
ENOUGH_MM, ENOUGH_DEG = 0.07, 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StabilityReport:
    """How a model behaves at the subject's own parameters and in a box around them.

    Attributes
    ----------
    trials
        Names of the trials, n of them.
    outcomes
        How each ended at the subject's own parameters.
    margins
        Stability margin of each there [N/mm], shape ``(n,)``; of the last stable pose where the
        trial did not converge.
    n_samples
        Parameter vectors drawn from the box: stiffness +-50 %, reference strain +-3 %, other
        amplitudes of effects over their plausible ranges.
    box_outcomes
        How many of the ``n * n_samples`` trials ended in each way.
    box_margins
        Lowest margin over the protocol of each vector [N/mm], shape ``(n_samples,)``; of those
        whose trials all converged, NaN for the others.
    change
        Largest change between the chosen contact points and all vertices, over trials that
        converge with both, in the order and units of `COORDINATES` [mm, deg], shape ``(5,)``;
        NaN where there is no such trial.
    moves
        Insertions moved within their uncertainty, the moves that restore most trials first; none
        where all converge.
    findings
        The same in sentences, each with its remedy.
    """

    trials: tuple[str, ...]
    outcomes: tuple[Outcome, ...]
    margins: Array
    n_samples: int
    box_outcomes: Mapping[Outcome, int]
    box_margins: Array
    change: Array
    moves: tuple[InsertionMove, ...] = ()
    findings: tuple[GeometryFinding, ...] = ()

    def __post_init__(self) -> None:
        for name, length in (
            ("margins", len(self.trials)),
            ("box_margins", self.n_samples),
            ("change", len(COORDINATES)),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), length, name=name))

    @property
    def n_converged(self) -> int:
        """How many trials converged at the subject's own parameters."""
        return self.outcomes.count(Outcome.CONVERGED)

    @property
    def lowest_margin(self) -> float:
        """Smallest margin of a trial that converged at the subject's own parameters [N/mm].

        NaN where none did.
        """
        return _lowest(self.margins[[x is Outcome.CONVERGED for x in self.outcomes]])

    @property
    def converged_share(self) -> float:
        """Share of all trials in the box that converged; NaN without samples."""
        total = sum(self.box_outcomes.values())
        return self.box_outcomes.get(Outcome.CONVERGED, 0) / total if total else float("nan")

    @property
    def change_mm(self) -> float:
        """Largest change of a translation by the choice of contact points [mm]."""
        return float(np.max(self.change[TRANSLATIONS]))

    @property
    def change_deg(self) -> float:
        """Largest change of a rotation by the choice of contact points [deg]."""
        return float(np.max(self.change[ROTATIONS]))


def check_stability(
    model: LaxityModel,
    *,
    n_samples: int = 200,
    within_mm: float = WITHIN,
    seed: int = 0,
    executor: Executor = serial,
) -> StabilityReport:
    """How well posed the model is over its protocol, with a sentence for each finding.

    Parameters
    ----------
    model
        A knee under a protocol.
    n_samples
        How many parameter vectors to draw from the box.
    within_mm
        How far insertions may be from where they are given [mm]: where trials are lost, each is
        moved so far to see what that restores.
    seed
        Seed of the draws.
    executor
        Anything with an ordered ``map`` that shares this process's memory.

    Raises
    ------
    ValueError
        If `n_samples` is negative or the distance is not between 0 and 8 mm. Trials without
        equilibrium are no error: they are findings.
    """
    if n_samples < 0:
        raise ValueError(f"the number of samples must be 0 or more, got {n_samples}")
    center = model.parameters.start
    own = model.predict(center, derivatives=False)
    whole = replace(model, n_points=None).predict(center, derivatives=False)
    vectors = box_sample(model.parameters, n_samples, np.random.default_rng(seed))
    predict: Callable[[Array], Prediction] = partial(model.predict, derivatives=False)
    counts: Counter[Outcome] = Counter()
    lowest = []
    drawn = executor.map(predict, vectors)
    for prediction in progress(drawn, total=n_samples, description="simulating the parameter box"):
        counts.update(prediction.outcomes)
        lowest.append(_lowest(prediction.margins) if prediction.all_converged else np.nan)
    moves: tuple[InsertionMove, ...] = ()
    if not own.all_converged:
        moves = rank_moves(model, within_mm=within_mm, executor=executor)
    report = StabilityReport(
        trials=model.protocol.trials,
        outcomes=own.outcomes,
        margins=own.margins,
        n_samples=n_samples,
        box_outcomes=dict(counts),
        box_margins=np.array(lowest),
        change=_largest_change(own, whole),
        moves=moves,
    )
    return replace(report, findings=_findings(report, model))


def box_sample(parameters: Parameters, n: int, generator: np.random.Generator) -> Array:
    """Parameter vectors drawn uniformly from the box around the subject's own, shape ``(n, p)``.

    Stiffnesses vary by +-50 % and reference strains by +-3 %, within the bounds; other amplitudes
    of effects over their plausible ranges, which are their bounds.
    """
    is_stiffness, is_strain = (
        np.array([name.endswith(f".{x}") for name in parameters.names]) for x in (STIFFNESS, STRAIN)
    )
    reach = np.select(
        [is_stiffness, is_strain], [STIFFNESS_SHARE * parameters.start, STRAIN_PCT], np.inf
    )
    # Of values that lie outside the bounds the nearest bound is left.
    low, high = (
        np.clip(parameters.start + x, parameters.lower, parameters.upper) for x in (-reach, reach)
    )
    return generator.uniform(low, high, size=(n, parameters.n))


def _largest_change(first: Prediction, second: Prediction) -> Array:
    both = first.is_converged & second.is_converged
    if not both.any():
        return np.full(len(COORDINATES), np.nan)
    difference = np.abs(first.coordinates[both] - second.coordinates[both])
    return np.asarray(difference.max(axis=0))


def _lowest(values: Array) -> float:
    return float(values.min()) if values.size else float("nan")


def _findings(report: StabilityReport, model: LaxityModel) -> tuple[GeometryFinding, ...]:
    protocol = model.protocol.name
    return (
        _own_finding(report, protocol),
        *([_box_finding(report, protocol)] if report.n_samples else []),
        _points_finding(report, protocol),
    )


def _own_finding(report: StabilityReport, protocol: str) -> GeometryFinding:
    n = len(report.trials)
    if report.n_converged < n:
        return GeometryFinding(
            severity="error",
            subject="stability",
            sentence=(
                f"{n - report.n_converged} of the {n} trials of {protocol} do not converge at the "
                f"subject's own parameters. {' '.join(_lost(report))}"
            ),
            remedy=(
                f"{_worth_moving(report.moves)} Otherwise correct the ligament parameters or lower "
                "the loads before calibrating: a model that loses trials has cliffs in its "
                "objective."
            ),
        )
    converged = [i for i, x in enumerate(report.outcomes) if x is Outcome.CONVERGED]
    weakest = min(converged, key=lambda i: float(report.margins[i]))
    is_low = report.lowest_margin < ENOUGH_MARGIN
    return GeometryFinding(
        severity="warning" if is_low else "info",
        subject="stability",
        sentence=(
            f"All {n} trials of {protocol} converge at the subject's own parameters; the lowest "
            f"stability margin is {report.lowest_margin:.3g} N/mm, in {report.trials[weakest]}."
        ),
        remedy=(
            f"Below {ENOUGH_MARGIN:g} N/mm a small change may end the branch: check the ligaments "
            "that hold this motion."
            if is_low
            else ""
        ),
    )


def _lost(report: StabilityReport) -> list[str]:
    """Of each way in which trials ended how many did, which, and what it means."""
    by_outcome: dict[Outcome, list[str]] = {}
    for trial, outcome in zip(report.trials, report.outcomes, strict=True):
        if outcome is not Outcome.CONVERGED:
            by_outcome.setdefault(outcome, []).append(trial)
    sentences = []
    for outcome, trials in by_outcome.items():
        named = ", ".join(trials[:MOST_LISTED])
        more = f" and {len(trials) - MOST_LISTED} more" if len(trials) > MOST_LISTED else ""
        sentences.append(f"{outcome.value} {len(trials)} ({named}{more}): {outcome.sentence}")
    return sentences


def _worth_moving(moves: tuple[InsertionMove, ...]) -> str:
    """Which insertions to move, where to and what that gains."""
    best = [x for x in moves if x.n_restored > 0][:MOST_LISTED]
    if not best:
        return (
            f"No single insertion moved by {moves[0].distance_mm:g} mm restores a trial; several "
            "together may: identknee subject settle."
        )
    gains = ", ".join(f"{x.words} (restores {x.n_restored})" for x in best)
    return f"Move one insertion: {gains}; or several together: identknee subject settle."


def _box_finding(report: StabilityReport, protocol: str) -> GeometryFinding:
    share = report.converged_share
    failed: dict[Outcome, int] = {
        end: n for end, n in report.box_outcomes.items() if end is not Outcome.CONVERGED
    }
    n_failed = sum(bool(np.isnan(x)) for x in report.box_margins)
    is_low = share < ENOUGH_CONVERGED
    ended = f" ({_counted(failed)})" if failed else ""
    return GeometryFinding(
        severity="warning" if is_low else "info",
        subject="stability",
        sentence=(
            f"In the box of stiffness +-{100 * STIFFNESS_SHARE:g} % and reference strain "
            f"+-{STRAIN_PCT:g} %, {100 * share:.2f} % of the trials of {protocol} converge{ended}; "
            f"{n_failed} of {report.n_samples} parameter vectors lose at least one trial."
        ),
        remedy=(
            "Expect cliffs when calibrating: start near, keep to narrower bounds, or move the "
            "insertions."
            if is_low
            else ""
        ),
    )


def _points_finding(report: StabilityReport, protocol: str) -> GeometryFinding:
    if np.isnan(report.change).any():
        return GeometryFinding(
            severity="warning",
            subject="contact points",
            sentence="No trial converges both with the default contact points and all vertices.",
            remedy="Mend what stops the trials first.",
        )
    is_large = report.change_mm > ENOUGH_MM or report.change_deg > ENOUGH_DEG
    return GeometryFinding(
        severity="warning" if is_large else "info",
        subject="contact points",
        sentence=(
            f"Between the default contact points and all vertices the pose changes by at most "
            f"{report.change_mm:.3f} mm and {report.change_deg:.3f} deg over {protocol}."
        ),
        remedy=(
            f"More than {ENOUGH_MM:g} mm or {ENOUGH_DEG:g} deg: smooth the cartilage surfaces, or "
            "use LaxityModel(n_points=None)."
            if is_large
            else ""
        ),
    )


def counted_outcomes(outcomes: Sequence[Outcome]) -> str:
    """How many trials ended in each way but the good one, in words."""
    return _counted(Counter(x for x in outcomes if x is not Outcome.CONVERGED))


def _counted(outcomes: Mapping[Outcome, int]) -> str:
    return ", ".join(f"{outcome.value} {count}" for outcome, count in outcomes.items())
