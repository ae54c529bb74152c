"""Whether a subject is well posed: its stability margin, a box of parameters, contact and rims."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS
from identknee.model.insertion_moves import ENOUGH_MARGIN, WITHIN, InsertionMove, rank_moves
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.prediction import Prediction
from identknee.runs.declare import OF_COORDINATE, Array, array, declared, derived, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.findings import Finding, finding
from identknee.runs.progress import progress
from identknee.runs.record import Outcome
from identknee.runs.words import listed_first
from identknee.subject.check import GeometryFinding, geometry_finding

STIFFNESS_SHARE = 0.5
STRAIN_PCT = 3.0
# Trials and moves that a sentence lists.
MOST_LISTED = 4
ENOUGH_CONVERGED = 0.99
ENOUGH_MM, ENOUGH_DEG = 0.07, 0.25


@declared
class TrialStability:
    """How a trial ended at the subject's own parameters."""

    trial: str = entry("Name of the trial")
    outcome: Outcome = entry("How the trial ended")
    margin: float = entry(
        "Stability margin; of the last stable pose where the trial did not converge",
        unit="N/mm",
        key="margin_N_per_mm",
    )


@declared
class StabilityReport:
    """How a model behaves at the subject's own parameters and in a box around them.

    The box is +-50 % of each stiffness, +-3 % of reference strain, and the plausible ranges of
    other amplitudes of effects.
    """

    protocol: str = entry("Name of the protocol")
    trials: tuple[TrialStability, ...] = entry("How each trial ended", rows="trial")
    n_samples: int = entry("Parameter vectors drawn from the box", unit="1")
    box_outcomes: Mapping[Outcome, int] = entry(
        "How many trials of all vectors ended in each way", unit="1"
    )
    box_margins: Array = array(
        "Lowest margin over the protocol of each vector; NaN where a trial did not converge",
        "sample",
        unit="N/mm",
        key="box_margin_N_per_mm",
    )
    change: Array = array(
        "Largest change between the chosen contact points and all vertices, over trials that "
        "converge with both; NaN where there is none",
        "coordinate",
        unit=OF_COORDINATE,
        key="change_by_contact_points",
    )
    moves: tuple[InsertionMove, ...] = entry(
        "Insertions moved within their uncertainty, the moves that restore most trials first; none "
        "where all converge",
        default=(),
    )

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """How each trial ended at the subject's own parameters."""
        return tuple(x.outcome for x in self.trials)

    @property
    @derived("Trials of the protocol", unit="1")
    def n_trials(self) -> int:
        return len(self.trials)

    @property
    @derived("Trials that converged at the subject's own parameters", unit="1")
    def n_converged(self) -> int:
        return self.outcomes.count(Outcome.CONVERGED)

    @property
    @derived("Lowest margin of the converged trials", unit="N/mm", key="lowest_margin_N_per_mm")
    def lowest_margin(self) -> float:
        """Smallest margin of a trial that converged at the subject's own parameters [N/mm].

        NaN where none did.
        """
        margins = (x.margin for x in self.trials if x.outcome is Outcome.CONVERGED)
        return min(margins, default=np.nan)

    @property
    @derived("Share of the trials in the box that converged", unit="1", key="box_converged_share")
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

    @property
    @derived("Largest change if all vertices were contact points, as mm and deg")
    def contact_points_change(self) -> dict[str, float]:
        return {"mm": self.change_mm, "deg": self.change_deg}

    @property
    def findings(self) -> tuple[GeometryFinding, ...]:
        """Findings about stability, each with its remedy."""
        return (
            _own_finding(self),
            *([_box_finding(self)] if self.n_samples else []),
            _points_finding(self),
        )


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
        Anything with an ordered ``map``.

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
        margins = prediction.margins
        is_known = prediction.all_converged and margins.size
        lowest.append(float(margins.min()) if is_known else np.nan)
    moves: tuple[InsertionMove, ...] = ()
    if not own.all_converged:
        moves = rank_moves(model, within_mm=within_mm, executor=executor)
    ends = zip(model.protocol.trials, own.outcomes, own.margins.tolist(), strict=True)
    both = own.is_converged & whole.is_converged
    change = np.full(len(COORDINATES), np.nan)
    if both.any():
        change = np.abs(own.coordinates[both] - whole.coordinates[both]).max(axis=0)
    return StabilityReport(
        protocol=model.protocol.name,
        trials=tuple(TrialStability(trial=x, outcome=y, margin=z) for x, y, z in ends),
        n_samples=n_samples,
        box_outcomes=dict(counts),
        box_margins=np.array(lowest),
        change=change,
        moves=moves,
    )


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
    # Values outside the bounds are clipped to them.
    low, high = (
        np.clip(parameters.start + x, parameters.lower, parameters.upper) for x in (-reach, reach)
    )
    return generator.uniform(low, high, size=(n, parameters.n))


def _own_finding(report: StabilityReport) -> GeometryFinding:
    n, protocol = report.n_trials, report.protocol
    if report.n_converged < n:
        lost = [x.trial for x in report.trials if x.outcome is not Outcome.CONVERGED]
        best = [x for x in report.moves if x.n_restored > 0][:MOST_LISTED]
        gains = ", ".join(f"{x.words} (restores {x.n_restored})" for x in best)
        advice = f"Move one insertion: {gains}; or several together: identknee subject settle."
        if not best:
            advice = (
                f"No single insertion moved by {report.moves[0].distance_mm:g} mm restores a "
                "trial; several together may: identknee subject settle."
            )
        # For each way in which trials ended: how many, which, and what it means.
        by_outcome: dict[Outcome, list[str]] = {}
        for one in report.trials:
            if one.outcome is not Outcome.CONVERGED:
                by_outcome.setdefault(one.outcome, []).append(one.trial)
        sentences = []
        for outcome, trials in by_outcome.items():
            named = listed_first(trials, MOST_LISTED)
            many = "1 trial" if len(trials) == 1 else f"{len(trials)} trials"
            sentences.append(f"{many} ({named}): {outcome.sentence}")
        return geometry_finding(
            "trials-not-converging",
            "stability",
            f"{n - report.n_converged} of the {n} trials of {protocol} do not converge at the "
            f"subject's own parameters. {' '.join(sentences)}",
            {"n": n, "n_lost": len(lost), "trials": lost},
            remedy=f"{advice} Otherwise correct the ligament parameters or "
            "lower the loads before calibrating: a model that loses trials has cliffs in its "
            "objective.",
        )
    weakest = min(report.trials, key=lambda x: x.margin).trial
    is_low = report.lowest_margin < ENOUGH_MARGIN
    return geometry_finding(
        "margin-low" if is_low else "all-converge",
        "stability",
        f"All {n} trials of {protocol} converge at the subject's own parameters; the lowest "
        f"stability margin is {report.lowest_margin:.3g} N/mm, in {weakest}.",
        {"n": n, "margin_N_per_mm": report.lowest_margin, "trial": weakest},
        remedy=f"Below {ENOUGH_MARGIN:g} N/mm a small change may leave no stable pose: check the "
        "ligaments that hold this motion."
        if is_low
        else "",
    )


def _box_finding(report: StabilityReport) -> GeometryFinding:
    share = report.converged_share
    failed: dict[Outcome, int] = {
        end: n for end, n in report.box_outcomes.items() if end is not Outcome.CONVERGED
    }
    n_failed = sum(bool(np.isnan(x)) for x in report.box_margins)
    ended = f" ({_counted(failed)})" if failed else ""
    return geometry_finding(
        "box-loses-trials" if share < ENOUGH_CONVERGED else "box-converges",
        "stability",
        f"With stiffness varied by +-{100 * STIFFNESS_SHARE:g} % and reference strain by "
        f"+-{STRAIN_PCT:g} %, {100 * share:.2f} % of the trials of {report.protocol} "
        f"converge{ended}; {n_failed} of {report.n_samples} parameter sets lose at least "
        "one trial.",
        {"converged_pct": 100 * share, "n_lost": n_failed, "n": report.n_samples},
    )


def _points_finding(report: StabilityReport) -> GeometryFinding:
    code, where = "contact-points-coarse", "contact points"
    if np.isnan(report.change).any():
        sentence = "No trial converges both with the default contact points and all vertices."
        remedy = "Correct what stops the trials first."
        return geometry_finding(code, where, sentence, remedy=remedy)
    is_large = report.change_mm > ENOUGH_MM or report.change_deg > ENOUGH_DEG
    return geometry_finding(
        code if is_large else "contact-points-enough",
        where,
        "Between the default contact points and all vertices the pose changes by at most "
        f"{report.change_mm:.3f} mm and {report.change_deg:.3f} deg over {report.protocol}.",
        {"change_mm": report.change_mm, "change_deg": report.change_deg},
        remedy=f"More than {ENOUGH_MM:g} mm or {ENOUGH_DEG:g} deg: smooth the cartilage surfaces, "
        "or use LaxityModel(n_points=None)."
        if is_large
        else "",
    )


_ENDED = {
    Outcome.CONVERGED: "with a stable pose",
    Outcome.FOLD: "at a fold",
    Outcome.NO_EQUILIBRIUM: "without equilibrium",
    Outcome.UNCONSTRAINED: "with a free direction",
}


def outcome_counts_words(outcomes: Sequence[Outcome]) -> str:
    """Counts of the trials without an equilibrium by outcome, in words."""
    return _counted(Counter(x for x in outcomes if x is not Outcome.CONVERGED))


def _counted(outcomes: Mapping[Outcome, int]) -> str:
    return ", ".join(f"{count} {_ENDED[outcome]}" for outcome, count in outcomes.items())


def stability_findings(model: LaxityModel) -> tuple[Finding, ...]:
    """Whether the subject is stable at its own parameters under the trials of its data.

    What `identknee subject check` finds there goes with every result, because results of a knee
    that folds depend on where it folds.
    """
    found = model.predict(model.parameters.start, derivatives=False)
    n = model.protocol.n
    if not found.all_converged:
        lost = np.flatnonzero(~found.is_converged)
        first = model.protocol.trials[int(lost[0])]
        sentence = (
            f"The subject fails its stability check: at its own parameters {lost.size} of {n} "
            f"trials have no equilibrium ({outcome_counts_words(found.outcomes)}; the first is "
            f"{first}). See: identknee subject check SUBJECT --protocol DATA.csv"
        )
        values = {"n": n, "n_lost": lost.size, "first": first}
        return (finding("unstable-subject", "subject", values, sentence=sentence),)
    lowest = float(np.nanmin(found.margins, initial=np.inf))
    if lowest < ENOUGH_MARGIN:
        weakest = model.protocol.trials[int(np.nanargmin(found.margins))]
        sentence = (
            f"At its own parameters the subject is hardly stable: {lowest:.2g} N/mm in {weakest}, "
            f"less than {ENOUGH_MARGIN:g}. See: identknee subject check"
        )
        values = {"margin_N_per_mm": lowest, "trial": weakest}
        return (finding("hardly-stable-subject", "subject", values, sentence=sentence),)
    return ()


def rim_findings(trials: Sequence[str], found: Prediction) -> tuple[Finding, ...]:
    """Which of the trials press near a rim, where the cartilage surface ends."""
    near = np.flatnonzero(found.is_near_rim)
    if not near.size:
        return ()
    worst = near[int(np.argmax(found.rim_share[near]))]
    many = "1 trial" if near.size == 1 else f"{near.size} trials"
    sentence = (
        f"In {many} contact acts within 3 mm of a rim, where the surface ends (most in "
        f"{trials[worst]}, {found.rim_share[worst]:.0%} of the force): cartilage beyond the rim is "
        "missing from the model."
    )
    values = {"n": near.size, "trial": trials[worst], "force_share": found.rim_share[worst]}
    return (finding("contact-near-rim", "subject", values, sentence=sentence),)
