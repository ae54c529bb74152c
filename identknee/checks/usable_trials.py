"""Which measured trials a fit can use, and a start at which as many as possible have equilibrium.

A trial without equilibrium is held near its measured pose by a spring, and a fit moves the
parameters until the knee has an equilibrium without it. A trial that still has none is left out.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from identknee.calibrate.fit import Fit, StartLike, fit, load_start
from identknee.calibrate.problem import (
    FORCE_TERM,
    PLAUSIBILITY_TERM,
    SUPERPOSITION_TERM,
    TABLE_TERM,
    Problem,
    SumOfTerms,
    innermost,
    with_bounds,
    with_nuisance_priors,
)
from identknee.identify.optimum import REACH, sobol_around
from identknee.laxity.experiments import LOAD_CELL
from identknee.laxity.protocol import from_zero
from identknee.laxity.table import COORDINATES, Laxity
from identknee.mechanics.equilibria import NEAR, Continuation
from identknee.mechanics.memory import ROTATION_SCALE
from identknee.model.force_residuals import ForceResiduals, SuperpositionResiduals, weighed
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitResiduals
from identknee.model.mechanics_inputs import POSE_EVERY_DEG, known_poses, strains_as_measured
from identknee.model.prediction import Prediction
from identknee.model.residuals import (
    HeldTrials,
    LaxityResiduals,
    Weighting,
    has_shared_errors,
    shared_errors,
)
from identknee.runs.declare import Array, BoolArray
from identknee.runs.errors import ValueRefused
from identknee.runs.findings import Finding, finding
from identknee.runs.progress import progress
from identknee.runs.record import Outcome
from identknee.runs.words import listed, listed_first
from identknee.subject.knee import Knee

# Strains of each ligament at the longest of its measured lengths, from which searches begin.
STRETCHES = (0.04, 0.06, 0.08, 0.1)
# The same for the pattern of grouped bundles.
PATTERN_STRETCH = 0.06
BUDGET = 300
# Further starts: least stiffness [kN], and range of strain at the longest measured length [%].
LEAST_STIFFNESS, STRETCH_RANGE = 1.0, (-3.0, 10.0)
# Trials without equilibrium that are listed by name, for each reason.
MOST_LISTED = 6
ABOUT_FALLBACK = (
    "Geometry is uncertain: a trial whose load path ends, or whose unloaded knee is unstable, was "
    "looked for from its measured pose under its whole load."
)
ABOUT_NO_POSES = (
    "No trial has all five coordinates: equilibria were continued along load paths from the "
    "scanned pose, not sought at measured poses."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialSelection:
    """The data that can be fitted, and a start of the fit.

    Attributes
    ----------
    laxity
        The data, with blank cells for trials without equilibrium.
    start
        Theta where the fit begins, shape ``(p,)``. If the model begins at measured poses, all
        trials of `laxity` have an equilibrium there.
    sentences
        Report of what was done.
    is_moved
        Whether trials had no equilibrium where the fit was to begin.
    """

    laxity: Laxity
    start: Array
    sentences: tuple[str, ...] = ()
    is_moved: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The trials used."""
        return trial_names(self.laxity)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialSearch:
    """A search for parameters at which the measured trials have an equilibrium.

    Attributes
    ----------
    model
        The model of the data; its equilibria are followed from measured poses where possible.
    laxity
        The data.
    weighting
        As for `LaxityResiduals`.
    bounds, fixed
        As for `identknee.fit`.
    shared
        Errors that trials share, as for `LaxityResiduals`.
    """

    model: LaxityModel
    laxity: Laxity
    weighting: Weighting
    bounds: Mapping[str, tuple[float, float]]
    fixed: Sequence[str] = ()
    shared: Array | None = None

    @property
    def without_limits(self) -> "TrialSearch":
        """The same search without limits of plausibility; itself if there are none."""
        if not self.model.knee.plausibility:
            return self
        knee = self.model.knee.with_plausibility("none")
        return replace(self, model=replace(self.model, knee=knee))

    def linear_at(self, theta: Array) -> "TrialSearch":
        """The same search with errors linearised at `theta`; itself if there are none.

        These are the covariance of in-situ forces, and stated errors that trials share: zeros,
        single flexion angles and surfaces. The latter count only with a stated noise.
        """
        made = self
        if needs_weights(self.laxity):
            made = replace(made, laxity=weighed(self.laxity, self.model, theta))
        if self.weighting == "noise" and has_shared_errors(self.model.knee.uncertainty):
            made = replace(made, shared=shared_errors(self.model, theta))
        return made

    def used(self, start: Array) -> TrialSelection:
        """The trials to be fitted, and a start of the fit at or away from `start`.

        If trials have no equilibrium at `start`, a fit begins there with these trials held near
        their measured poses. If some are still held at its end, further fits begin with reference
        strains from the lengths of the ligaments in measured poses. If no trial has an equilibrium
        at the best end, all trials are kept.
        """
        said = path_findings(self.model)
        lost = self.measured & ~self.has_equilibrium(start)
        if not lost.any():
            return TrialSelection(laxity=self.laxity, start=start, sentences=said)
        # The fits by the words for their starts.
        made = {"the given start": self._fit_from(start)}
        if self.model.poses is not None and not self._has_all(made["the given start"].theta):
            of_each = "% of strain at the longest measured length of each ligament"
            others = progress(
                [(f"{100 * x:.0f} {of_each}", self.stretched(start, x)) for x in STRETCHES],
                description="looking for a start at which all trials have an equilibrium",
            )
            made |= {words: self._fit_from(theta) for words, theta in others}
        best = min(made, key=lambda x: made[x].objective)
        theta = made[best].theta
        laxity = self.with_equilibrium(theta)
        if not laxity.is_measured.any():
            return TrialSelection(laxity=self.laxity, start=start, sentences=said)
        of_many = f", the best of {len(made)} such starts" if len(made) > 1 else ""
        sentence = (
            f"At the start {lost.sum()} of {self.measured.sum()} measured trials had no "
            f"equilibrium. The fit began from {best}{of_many}. These trials were held near their "
            "measured poses by a spring until they had an equilibrium without it "
            f"({sum(x.n_simulations for x in made.values())} simulations)."
        )
        return TrialSelection(
            laxity=laxity, start=theta, sentences=(*said, sentence), is_moved=True
        )

    def fitted(self, start: Array, search: Callable[..., Fit]) -> tuple[TrialSelection, Fit]:
        """The trials used, and the fit to them by `search`."""
        used = self.used(start)
        found = search(self.problem(used.laxity), used.start, fixed=self.fixed)
        return used, replace(found, start=start)

    @property
    def measured(self) -> BoolArray:
        """Which trials have data, shape ``(n,)``."""
        return np.asarray(self.laxity.is_measured.any(axis=1))

    def has_equilibrium(self, theta: Array) -> BoolArray:
        """Which trials have an equilibrium, shape ``(n,)``."""
        found = self.model.predict(theta, derivatives=False).is_converged
        # A change from a zero pose needs an equilibrium in both trials.
        seen = np.where(found, 0.0, np.nan)
        return ~np.isnan(from_zero(seen, self.laxity.protocol, self.laxity.zero))

    def with_equilibrium(self, theta: Array) -> Laxity:
        """The data, with blank cells for trials without equilibrium."""
        return self.laxity.without(~self.has_equilibrium(theta))

    def problem(self, laxity: Laxity) -> Problem:
        """The residuals of the model against `laxity`, with priors of the nuisances."""
        residuals = self.residuals(laxity)
        return with_nuisance_priors(with_bounds(with_other_terms(residuals), self.bounds))

    def problem_everywhere(self, laxity: Laxity) -> Problem:
        """The same as `problem`, with trials without equilibrium held near their measured poses."""
        residuals = self.residuals(laxity)
        return with_nuisance_priors(with_bounds(defined_everywhere(residuals), self.bounds))

    def residuals(self, laxity: Laxity) -> LaxityResiduals:
        """The residuals of the coordinates of `laxity` alone."""
        return LaxityResiduals(
            model=self.model, laxity=laxity, weighting=self.weighting, shared=self.shared
        )

    def stretched(self, start: Array, stretch: float) -> Array:
        """`start` with the reference strains that stretch each ligament by `stretch`, in bounds.

        The stretch is that at the longest of the measured lengths of a ligament.
        """
        parameters = self.problem(self.laxity).parameters
        n, m = self.model.tied.n, len(self.model.knee.ligaments)
        theta = np.array(start)
        strains = strains_as_measured(self.model.setting(start), stretch)[:m]
        theta[n : 2 * n] = self.model.tied.strain_upper_limits(strains)
        theta = np.clip(theta, parameters.lower, parameters.upper)
        held = [parameters.index(x) for x in self.fixed]
        theta[held] = start[held]
        return theta

    def _fit_from(self, start: Array) -> Fit:
        problem = self.problem_everywhere(self.laxity)
        return fit(problem, start, budget=BUDGET, fixed=self.fixed)

    def _has_all(self, theta: Array) -> bool:
        return bool(self.has_equilibrium(theta)[self.measured].all())


def starts_elsewhere(model: LaxityModel, start: Array, n: int, *, seed: int = 0) -> Array:
    """Starts of further searches, shape ``(n, p)``: around the start, or by stretch.

    They are by stretch if the model begins at measured poses. Of 128 such starts of the measured
    knee with bundles, 4 led to its lowest fits, and none of 128 around the start.
    """
    if model.poses is None:
        return sobol_around(model.parameters, start, n, reach=REACH, seed=seed)
    nuisances = ~model.parameters.is_of_interest
    middle = np.where(nuisances, model.parameters.start, start)
    return starts_by_stretch(model, middle, n, seed=seed)


def starts_by_stretch(model: LaxityModel, start: Array, n: int, *, seed: int = 0) -> Array:
    """Starts whose ligaments are stretched by a few percent in the measured poses, ``(n, p)``.

    A Sobol sequence in the logarithm of each stiffness, within its bounds and above 1 kN, and in
    the strain of each ligament at the longest of its measured lengths, from -3 to 10 %. Most points
    of the box of parameters stretch some ligament until nothing balances it.

    Parameters
    ----------
    model
        A model that begins at measured poses.
    start
        Values of all other parameters, shape ``(p,)``.
    n
        Number of starts.
    seed
        Seed of the scrambling.
    """
    u, parameters = model.tied.n, model.parameters
    drawn = scipy.stats.qmc.Sobol(2 * u, seed=seed).random_base2(int(np.ceil(np.log2(n))))[:n]
    low, high = np.maximum(parameters.lower[:u], LEAST_STIFFNESS), parameters.upper[:u]
    slack = strains_as_measured(model.setting(start), 0.0)[: len(model.knee.ligaments)]
    starts = np.tile(start, (n, 1))
    starts[:, :u] = low * (high / low) ** drawn[:, :u]
    strains = model.tied.strain_upper_limits(slack) + STRETCH_RANGE[0]
    starts[:, u : 2 * u] = strains + (STRETCH_RANGE[1] - STRETCH_RANGE[0]) * drawn[:, u:]
    return np.clip(starts, parameters.lower, parameters.upper)


def held_everywhere(residuals: LaxityResiduals) -> LaxityResiduals:
    """The residuals with trials without equilibrium held near their measured poses."""
    held = HeldTrials(model=residuals.model, laxity=residuals.laxity)
    return replace(residuals, held=held)


def defined_everywhere(residuals: LaxityResiduals) -> Problem:
    """`held_everywhere`, with the other terms of `with_other_terms`."""
    return with_other_terms(held_everywhere(residuals))


def with_other_terms(residuals: LaxityResiduals) -> Problem:
    """The residuals of a table, of forces measured with it, and of limits that the knee has.

    Raises
    ------
    ValueError
        If there are forces or limits, and the noise of the coordinates is not stated.
    """
    laxity, everywhere = residuals.laxity, residuals.held is not None
    others = {
        **force_terms(residuals.model, laxity, is_everywhere=everywhere),
        **limit_terms(residuals.model, is_everywhere=everywhere),
    }
    if not others:
        return residuals
    if residuals.weighting != "noise":
        what = "limits of plausibility" if residuals.model.knee.plausibility else "measured forces"
        raise ValueRefused(
            f"{what} count beside coordinates only where the noise of these is known",
            "state it with --noise, for example --noise 0.5mm,0.5deg",
        )
    n = int(laxity.is_measured.sum()) + (laxity.n if everywhere else 0)
    return SumOfTerms(
        terms={TABLE_TERM: residuals, **others}, sizes=(n, *(x.n for x in others.values()))
    )


def limit_terms(model: LaxityModel, *, is_everywhere: bool = False) -> dict[str, LimitResiduals]:
    """The residuals of a knee's limits by the name of their term; empty without limits."""
    limits = model.knee.plausibility
    made = LimitResiduals(model=model, limits=limits, is_everywhere=is_everywhere)
    return {PLAUSIBILITY_TERM: made} if made.n else {}


def force_terms(
    model: LaxityModel, laxity: Laxity, *, is_everywhere: bool = False
) -> dict[str, ForceResiduals | SuperpositionResiduals]:
    """The residuals of forces by the name of their term: of trials, and of replayed paths.

    Parameters
    ----------
    model, laxity
        The model and the data.
    is_everywhere
        Whether forces of trials without equilibrium are left out.
    """
    found: dict[str, ForceResiduals | SuperpositionResiduals] = {}
    if laxity.forces is not None and laxity.forces.is_measured.any():
        found[FORCE_TERM] = ForceResiduals(
            model=model, forces=laxity.forces, is_everywhere=is_everywhere
        )
    if laxity.superposition is not None:
        found[SUPERPOSITION_TERM] = SuperpositionResiduals(
            model=model, superposition=laxity.superposition, is_everywhere=is_everywhere
        )
    return found


def needs_weights(laxity: Laxity) -> bool:
    """Whether the covariance of in-situ forces depends on the parameters."""
    made = laxity.superposition
    return made is not None and bool(made.pose_sd.any() or made.is_measured[:, -1].any())


def residuals_of(problem: Problem) -> LaxityResiduals:
    """The residuals of the table of a problem that `TrialSearch` made."""
    inner = innermost(problem)
    inner = inner.terms[TABLE_TERM] if isinstance(inner, SumOfTerms) else inner
    if not isinstance(inner, LaxityResiduals):
        raise TypeError(f"{type(inner).__name__} has no residuals of a table")
    return inner


def table_model(
    knee: Knee, laxity: Laxity, continuation: Continuation = "continuation"
) -> tuple[LaxityModel, tuple[str, ...]]:
    """The model of measured laxity, and a sentence if reference strains of the knee were changed.

    Fits keep the differences of strain between grouped bundles. If trials have no equilibrium at
    the knee's own strains, these differences are replaced by those that stretch every bundle alike
    at the longest of its measured lengths.
    """
    model = LaxityModel(knee=knee, protocol=laxity.protocol, continuation=continuation)
    model = model.with_tests(laxity)
    if not knee.groups or knee.fitted or model.poses is None:
        return model, ()
    measured = laxity.is_measured.any(axis=1)
    start = model.parameters.start
    if model.predict(start, derivatives=False).is_converged[measured].all():
        return model, ()
    strains = strains_as_measured(model.setting(start), PATTERN_STRETCH).tolist()
    tied = {member for group in knee.groups for member in group.members}
    ligaments = [
        replace(x, reference_strain_pct=strain) if x.name in tied else x
        for x, strain in zip(knee.ligaments, strains[: len(knee.ligaments)], strict=True)
    ]
    sentence = (
        "At the strains of the subject not all trials have an equilibrium, so grouped bundles keep "
        f"another pattern: that which stretches each by {100 * PATTERN_STRETCH:.0f} % at the "
        "longest of its measured lengths."
    )
    return replace(model, knee=knee.with_ligaments(ligaments)), (sentence,)


def knee_with_equilibria(
    knee: Knee, laxity: Laxity, start: StartLike
) -> tuple[Knee, TrialSelection]:
    """The knee, fitted where trials have an equilibrium, and these trials.

    Only the start moves: priors stay centred on the values that the subject came with, as in every
    verb.
    """
    model, said = table_model(knee, laxity)
    trials = TrialSearch(model=model, laxity=laxity, weighting="unit", bounds={})
    begun = load_start(start, model.parameters)
    used = trials.used(begun)
    knee = model.knee
    if not np.array_equal(used.start, model.parameters.start):
        at = dict(zip(model.parameters.names, used.start.tolist(), strict=True))
        knee = replace(knee, fitted=at)
    return knee, replace(used, sentences=(*said, *used.sentences))


def trial_names(laxity: Laxity) -> tuple[str, ...]:
    """The trials with measured values."""
    return tuple(laxity.protocol.trials[i] for i in np.flatnonzero(laxity.is_measured.any(axis=1)))


def blank_cell_findings(laxity: Laxity) -> tuple[str, ...]:
    """Sentences on coordinates that were not measured, and on trials that are only predicted."""
    columns = zip(COORDINATES, laxity.is_measured.T, strict=True)
    said = [f"{name} was not measured." for name, column in columns if not column.any()]
    known = set(trial_names(laxity))
    blank = [x for x in laxity.protocol.trials if x not in known]
    if blank:
        are = "it is" if len(blank) == 1 else "they are"
        said.append(f"No value of {', '.join(blank)} was used: {are} only predicted.")
    return tuple(said)


def experiment_sentences(laxity: Laxity) -> tuple[str, ...]:
    """A sentence on which experiments share a rig and a mounting; empty for a single table."""
    experiments = laxity.protocol.experiments
    if len(experiments) < 2:
        return superposition_sentences(laxity)
    mounted: dict[str, list[str]] = {}
    for x in experiments:
        mounted.setdefault(x.mounting, []).append(x.name)
    rigs = len({x.rig for x in experiments})
    groups = "; ".join(listed(names) for names in mounted.values())
    n, m = len(experiments), len(mounted)
    sentence = (
        f"{n} experiments on one knee, of {rigs} rig{'s' * (rigs > 1)} and {m} "
        f"mounting{'s' * (m > 1)} ({groups}): those of one mounting share its errors."
    )
    return (sentence, *superposition_sentences(laxity))


def superposition_sentences(laxity: Laxity) -> tuple[str, ...]:
    """A sentence on in-situ forces and those of their errors that count; empty without any."""
    if (made := laxity.superposition) is None:
        return ()
    paths = len(set(made.trials))
    units = dict(zip(LOAD_CELL, ("N", "N·m"), strict=True))
    cells = []
    for x in {x.rig: x for x in laxity.protocol.experiments}.values():
        sizes = {name: x.uncertainty.get(name, 0.0) for name in LOAD_CELL}
        if own := [f"{size:g} {units[name]}" for name, size in sizes.items() if size > 0.0]:
            cells.append(f"{x.rig} ({', '.join(own)})")
    poses = f"{made.pose_sd[:, 0].max():g} mm and {made.pose_sd[:, 1].max():g} deg"
    errors = [
        *([f"the replayed pose (up to {poses})"] if made.pose_sd.any() else []),
        *([f"a constant error of the load cell of {listed(cells)}"] if cells else []),
    ]
    beside = f" Beside the noise of readings: {listed(errors)}." if errors else ""
    sentence = (
        f"In-situ forces of {listed(list(dict.fromkeys(made.cut)))} in {paths} replayed "
        f"path{'s' * (paths > 1)} were predicted in the model's equilibrium of each trial.{beside}"
    )
    return (sentence,)


def input_findings(knee: Knee, laxity: Laxity) -> tuple[str, ...]:
    """Sentences on what a fit assumes: stated uncertainty, blank cells, and errors not used."""
    said = (
        knee.uncertainty.sentence,
        *experiment_sentences(laxity),
        *blank_cell_findings(laxity),
    )
    if laxity.sd is None:
        return said
    stated = ~np.isnan(laxity.sd)
    if stated[laxity.is_measured].all():
        return said
    names = ", ".join(COORDINATES[i] for i in np.flatnonzero(np.any(stated, axis=0)))
    sentence = (
        f"Errors are stated of {names} only, so they were not used: 1 mm is weighted like 1 deg"
        ". State all, or give --noise."
    )
    return (*said, sentence)


def excluded_trial_findings(knee: Knee, laxity: Laxity, used: Laxity) -> tuple[Finding, ...]:
    """A finding if measured trials were not fitted."""
    measured, kept = trial_names(laxity), trial_names(used)
    lost = [x for x in measured if x not in kept]
    if not lost:
        return ()
    is_exact = knee.uncertainty.is_exact
    or_state = ", or state how well geometry is known with --uncertain" if is_exact else ""
    sentence = (
        f"The result is based on {len(kept)} of {len(measured)} measured trials: the model has no "
        f"equilibrium in {', '.join(lost)}. Check these trials in the raw data{or_state}."
    )
    values = {"n_measured": len(measured), "n_used": len(kept), "trials": lost}
    return (finding("trials-lost", "trials", values, sentence=sentence),)


def unfitted_findings(laxity: Laxity, prediction: Prediction) -> tuple[Finding, ...]:
    """Findings on why no search could begin: trials without prediction, or the bounds."""
    measured = np.any(laxity.is_measured, axis=1)
    lost = measured & ~prediction.is_converged
    if not lost.any():
        sentence = (
            "Nothing was fitted: the start lies outside the bounds of the parameters, and inside "
            "them trials have no equilibrium. Choose another --start or --bounds."
        )
        return (finding("nothing-fitted", "starts", sentence=sentence),)
    sentence = (
        f"Nothing was fitted: at the start {lost.sum()} of {measured.sum()} measured trials have "
        "no equilibrium. Choose another --start, or leave the cells of such trials blank."
    )
    values = {"n_measured": measured.sum(), "n_lost": lost.sum()}
    by_outcome: dict[Outcome, list[str]] = {}
    for i in np.flatnonzero(lost):
        by_outcome.setdefault(prediction.outcomes[i], []).append(laxity.protocol.trials[i])
    return (
        finding("nothing-fitted", "starts", values, sentence=sentence),
        *(
            finding(
                "trials-without-equilibrium",
                "trials",
                {"outcome": outcome.value, "trials": trials},
                sentence=f"{listed_first(trials, MOST_LISTED)}: {outcome.sentence}",
            )
            for outcome, trials in by_outcome.items()
        ),
    )


def prediction_finding(model: LaxityModel, laxity: Laxity, start: Array) -> Finding:
    """The finding that no parameters near the start predict all measured trials."""
    prediction = model.predict(start, derivatives=False)
    used = np.any(laxity.is_measured, axis=1).tolist()
    lost = [
        (trial, outcome)
        for trial, outcome, is_used in zip(
            model.protocol.trials, prediction.outcomes, used, strict=True
        )
        if is_used and outcome is not Outcome.CONVERGED
    ]
    where = ""
    if lost:
        trial, outcome = lost[0]
        where = (
            f" At the start {len(lost)} of {sum(used)} trials have none; {trial}: "
            f"{outcome.sentence}"
        )
    sentence = (
        f"no parameters near the start have a prediction in every measured trial.{where} Choose "
        "another --start, leave the cells of such trials blank, or see: identknee subject check"
    )
    values = {"n_measured": sum(used), "trials": [x for x, _ in lost]}
    return finding("no-prediction", "trials", values, sentence=sentence)


def path_findings(model: LaxityModel) -> tuple[str, ...]:
    """Sentences on where equilibria were searched for, unless on paths from the scanned pose."""
    if model.fallback_poses is not None:
        has_poses = np.isfinite(model.fallback_poses).all(axis=1).any()
        return (ABOUT_FALLBACK if has_poses else ABOUT_NO_POSES,)
    if model.poses is None:
        return ()
    known = known_poses(model.knee, model.protocol)
    if known is not None and np.array_equal(model.poses, known):
        sentence = (
            "Equilibria were continued under increasing loads from the poses that the fitted "
            "subject states for each flexion angle, not from measured ones."
        )
        angles, stated = model.protocol.flexion_deg, [x.flexion_deg for x in model.knee.poses]
        low, high = min(stated), max(stated)
        is_beyond = (angles < low - POSE_EVERY_DEG) | (angles > high + POSE_EVERY_DEG)
        if is_beyond.any():
            names = ", ".join(model.protocol.trials[i] for i in np.flatnonzero(is_beyond))
            beyond = (
                f"These poses lie at {low:.0f} to {high:.0f} deg of flexion: predictions of "
                f"trials far beyond ({names}) are extrapolated."
            )
            return (sentence, beyond)
        return (sentence,)
    sentence = (
        "Each trial has a flexion angle of its own, as a rig reads it: its equilibrium was looked "
        "for from its measured pose under its whole load, not along a path from the scanned pose, "
        f"and counts within {NEAR:.0f} mm and {np.degrees(NEAR / ROTATION_SCALE):.0f} deg of it."
    )
    return (sentence,)


def candidate_path_findings(model: LaxityModel) -> tuple[str, ...]:
    """The same for trials that were not made."""
    if model.poses is None:
        return ()
    sentence = (
        "A trial that was not made has no measured pose: its equilibrium was continued under a "
        "growing load from the mean pose of the trials made, interpolated over flexion."
    )
    return (sentence,)
