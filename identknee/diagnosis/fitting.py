"""Fits of a laxity model to data, without and with causes, as diagnosis compares them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import chdtrc
from typing_extensions import override

from identknee.calibrate.bounded_least_squares import ConstrainedFit, minimise
from identknee.calibrate.problem import (
    TABLE_TERM,
    Evaluation,
    Evaluator,
    EvidenceTerm,
    ProblemAround,
    ProblemWithPriors,
    SumOfTerms,
    evidence_terms,
)
from identknee.checks.data_noise import DataNoise
from identknee.checks.fit_checks import (
    BEYOND_PRIOR,
    ComparedForces,
    compared_forces,
    nuisance_findings,
)
from identknee.checks.usable_trials import force_terms
from identknee.diagnosis.force_rows import ForceRows
from identknee.diagnosis.misfit import (
    Projector,
    base_projector,
    cauchy_combination,
    chi2_or_f_test,
    nested_check,
    process_check,
    process_errors,
    smooth_patterns,
)
from identknee.diagnosis.noise_model import NoiseModel, build_noise_model
from identknee.diagnosis.score import LEAST_DISTANCE, CandidateScore, Scores
from identknee.identify.laplace import Laplace, laplace, log_evidence
from identknee.identify.optimum import (
    NuisanceEstimate,
    NuisanceGroup,
    nuisance_estimates,
    nuisance_groups,
)
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.effects.effect import Effect, is_error_of_rig
from identknee.model.effects.facts import cause_label
from identknee.model.effects.library import knee_with_effects, values_by_owner
from identknee.model.effects.tissues import CONTACT_LAW, contact_nuisance
from identknee.model.laxity_model import LaxityModel
from identknee.model.missing_wrench import wrench_response
from identknee.model.residuals import LaxityResiduals, nuisance_changes
from identknee.runs.declare import Array, BoolArray, declared, entry, short_repr
from identknee.runs.findings import Finding
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee

# Tolerance on the deviance; later statistics are accurate to a thousandth of a unit at best.
TOLERANCE = 1e-4
MOST_STEPS = 40
# Gauss-Newton steps before curvature is learned. Learned sooner, it leads to other minima.
STRAIGHT_STEPS = 12
# Share of the largest load of the data below which a knee seldom jumps.
LOW_LOADS = 0.5


@declared
class WhitenedProblem(ProblemAround):
    """Model and data compared in mm and deg, whitened by a noise model."""

    noise: NoiseModel = entry("The errors of the measured values")

    @override
    def residuals(self, theta: Array) -> Array:
        """Predicted less measured, whitened, shape ``(m,)``; infinite without a prediction."""
        residuals = self.problem.residuals(theta)
        return self.noise.whiten(residuals) if np.isfinite(residuals).all() else residuals

    @override
    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m, p)``."""
        return self.noise.whiten(self.problem.jacobian(theta))


@declared
class ProblemWithForces(ProblemAround):
    """Residuals of a table, whitened, and of forces given these: nuisances are common to both."""

    problem: SumOfTerms = entry("The table, whitened, then forces in units of their own errors")
    noise: NoiseModel = entry("The errors of the table, and its nuisances")

    @override
    def residuals(self, theta: Array) -> Array:
        """Predicted less measured, whitened, shape ``(m + f,)``; infinite without a prediction."""
        residuals = self.problem.residuals(theta)
        return self._whitened(residuals) if np.isfinite(residuals).all() else residuals

    @override
    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m + f, p)``."""
        return self._whitened(self.problem.jacobian(theta))

    def _whitened(self, rows: Array) -> Array:
        table, forces = rows[: self.noise.n], rows[self.noise.n :]
        return np.concatenate([table, self.noise.whiten_beside(forces, table)])


def whitened_problem(model: LaxityModel, laxity: Laxity, noise: NoiseModel) -> ProblemWithPriors:
    """The problem of fitting the model to the data, the priors of all parameters included."""
    compared = LaxityResiduals(model=model, laxity=laxity)
    table = WhitenedProblem(problem=compared, noise=noise)
    forces = force_terms(compared.model, laxity)
    if not forces:
        return ProblemWithPriors(problem=table)
    sizes = (noise.n, *(x.n for x in forces.values()))
    terms = SumOfTerms(terms={TABLE_TERM: table, **forces}, sizes=sizes)
    return ProblemWithPriors(problem=ProblemWithForces(problem=terms, noise=noise))


@declared
class FittedModel:
    """A model fitted to data, with its residuals."""

    model: LaxityModel = entry("Model that was fitted")
    laxity: Laxity = entry("Data that it was fitted to")
    noise: NoiseModel = entry("Covariance of the measured values, nuisances included")
    constrained: ConstrainedFit = entry("The fit")

    @property
    def theta(self) -> Array:
        """The parameters found, shape ``(p,)``."""
        return self.constrained.evaluation.theta

    @property
    def evaluation(self) -> Evaluation:
        """Whitened residuals and Jacobian there, rows of the prior included."""
        return self.constrained.evaluation

    @property
    def deviance(self) -> float:
        """Misfit and priors, in units of the noise."""
        return self.evaluation.deviance

    @property
    def misfit(self) -> float:
        """Chi-square of the data alone."""
        data = self.evaluation.residuals[: self.n_data]
        return float(data @ data)

    @property
    def n_coordinates(self) -> int:
        """Coordinates measured: the first of the rows."""
        return int(self.laxity.is_measured.sum())

    @property
    def n_data(self) -> int:
        """Values measured: coordinates, then forces."""
        return self.laxity.n_values

    @property
    def forces(self) -> ForceRows:
        """The forces measured."""
        return ForceRows(model=self.model, laxity=self.laxity)

    @property
    def compared(self) -> LaxityResiduals:
        """Model and data, compared in mm and deg."""
        return LaxityResiduals(model=self.model, laxity=self.laxity)

    @property
    def problem(self) -> ProblemWithPriors:
        """What was fitted."""
        return whitened_problem(self.model, self.laxity, self.noise)

    @property
    def nuisance_findings(self) -> tuple[Finding, ...]:
        """Nuisances whose estimate is improbable under their prior."""
        return nuisance_findings(self.problem, self.theta, hint="")

    @property
    def differences(self) -> Array:
        """Measured less predicted coordinates, shape ``(n, 5)``."""
        return self.compared.differences(self.theta)

    @property
    def outcome(self) -> Outcome:
        """How the fit ended."""
        return self.constrained.outcome

    def residual_rows(self) -> Array:
        """Measured less predicted, whitened, then the rows of the priors, shape ``(m + p,)``."""
        return -self.evaluation.residuals

    @property
    def evidence(self) -> tuple[EvidenceTerm, ...]:
        """Terms of the deviance of the fit."""
        return evidence_terms(self.problem, self.theta)

    @property
    def compared_forces(self) -> ComparedForces | None:
        """Measured and predicted forces; None where none was measured."""
        return compared_forces(self.problem, self.theta)

    @property
    def nuisances(self) -> tuple[NuisanceEstimate, ...]:
        """The nuisance parameters of the knee at the fit."""
        return nuisance_estimates(self.problem, self.theta)

    @property
    def nuisance_groups(self) -> tuple[NuisanceGroup, ...]:
        """How improbable those of each kind and place are under their prior; empty without any."""
        if self.model.parameters.is_of_interest.all():
            return ()
        return nuisance_groups(self.problem, self.theta)

    @property
    def projector(self) -> Projector:
        """The projector off the fitted parameters."""
        return base_projector(self.evaluation.jacobian)

    @property
    def counts_as_misfit(self) -> BoolArray:
        """Which rows say whether the model fits, shape ``(m + p,)``: all but ligaments' priors.

        A ligament far from its prior is a finding about the knee, and no fault of the model.
        """
        counts = np.ones(len(self.evaluation.residuals), bool)
        counts[self.n_data : self.n_data + self.model.n_ligament_parameters] = False
        return counts

    @property
    def is_scored(self) -> BoolArray:
        """Which rows causes are scored by, shape ``(m + p,)``: all but priors that are refuted.

        That an effect brings ligaments back to their priors favours it, unless the data put
        a ligament so far off that its prior says nothing of this knee.
        """
        scored, n = np.ones(len(self.evaluation.residuals), bool), self.model.tied.n
        scored[self.n_data : self.n_data + 2 * n] = np.tile(~self.is_refuted, 2)
        return scored

    @property
    def is_refuted(self) -> BoolArray:
        """Of which ligaments the data refute the prior, shape ``(u,)``; groups count as one."""
        n = self.model.tied.n
        away = self.evaluation.residuals[self.n_data : self.n_data + 2 * n].reshape(2, n)
        return np.asarray(n * chdtrc(2.0, (away**2).sum(axis=0)) < BEYOND_PRIOR)

    @property
    def scored_rows(self) -> Array:
        """Measured less predicted, whitened, then the priors that causes are scored by."""
        return self.residual_rows()[self.is_scored]

    @property
    def scored_projector(self) -> Projector:
        """The projector off the fitted parameters in those rows."""
        return base_projector(self.evaluation.jacobian[self.is_scored])

    @property
    def misfit_rows(self) -> Array:
        """Measured less predicted, whitened, then the priors of nuisances and of causes."""
        return self.residual_rows()[self.counts_as_misfit]

    @property
    def misfit_projector(self) -> Projector:
        """The projector off the fitted parameters in those rows, ligaments without a prior."""
        return base_projector(self.evaluation.jacobian[self.counts_as_misfit])

    def columns(self, changes: Array, of_forces: Array | None = None) -> Array:
        """Changes of the coordinates (n, 5, k) and of the forces, whitened, shape ``(m, k)``.

        Parameters
        ----------
        changes
            Of the coordinates [mm, deg].
        of_forces
            Of the forces, in units of their errors, shape ``(f, k)``; none if None.
        """
        table = self.noise.whiten(self.compared.rows(changes))
        if self.n_data == self.n_coordinates:
            return table
        if of_forces is None:
            of_forces = np.zeros((self.n_data - self.n_coordinates, table.shape[1]))
        return np.concatenate([table, self.noise.whiten_beside(of_forces, table)])


# Cached, since causes, ligaments and gain need it in turn.
@lru_cache(maxsize=4)
def posterior_of(fitted: FittedModel) -> Laplace:
    """Intervals of all parameters of a fit."""
    return laplace(fitted.evaluation, fitted.model.parameters, fitted.noise.scale)


def best_fit_from(
    model: LaxityModel,
    laxity: Laxity,
    noise: NoiseModel,
    starts: Sequence[Array],
    *,
    most_steps: int = MOST_STEPS,
    ends: Sequence[Evaluation] = (),
    known: Sequence[Evaluation] = (),
) -> FittedModel:
    """The lowest of several fits.

    Parameters
    ----------
    model, laxity, noise
        The model, the data and their errors.
    starts
        Where the fits begin, each shape ``(p,)``.
    most_steps
        Steps of each at most.
    ends
        Where fits ended before: one that joins them, or a minimum of those from the starts before,
        is not continued.
    known
        Evaluations of the same problem where fits begin.
    """
    problem, tried, found = whitened_problem(model, laxity, noise), [*ends], list[ConstrainedFit]()
    for i, start in enumerate(starts):
        if any(np.array_equal(start, x) for x in starts[:i]):
            continue
        found.append(descended(problem, start, tried, most_steps, known))
        if found[-1].outcome is Outcome.MINIMUM:
            tried.append(found[-1].evaluation)
    best = min(found, key=lambda x: x.evaluation.deviance)
    return FittedModel(model=model, laxity=laxity, noise=noise, constrained=best)


def descended(
    problem: ProblemWithPriors,
    start: Array,
    ends: Sequence[Evaluation],
    most_steps: int,
    known: Sequence[Evaluation] = (),
) -> ConstrainedFit:
    """The fit from one start: Gauss-Newton steps, then steps with learned curvature."""
    evaluator = Evaluator(problem, ends=ends, known=known)
    first = minimise(
        evaluator, start, tolerance=TOLERANCE, most_steps=min(STRAIGHT_STEPS, most_steps)
    )
    left = most_steps - STRAIGHT_STEPS
    if left <= 0 or first.outcome is not Outcome.VALLEY or first.n_simulations <= STRAIGHT_STEPS:
        return first
    evaluator = Evaluator(problem, ends=ends, known=[first.evaluation], learns_curvature=True)
    then = minimise(evaluator, first.evaluation.theta, tolerance=TOLERANCE, most_steps=left)
    return replace(then, n_simulations=first.n_simulations + then.n_simulations)


def fitted_with_nuisances(fitted: FittedModel, sd: Array, correlation: float) -> FittedModel:
    """A fit repeated from where it ended, with misfit that is not to be named among the errors."""
    changes, spreads = nuisance_changes(fitted.model, fitted.theta)
    noise = build_noise_model(
        sd,
        fitted.laxity.is_measured,
        correlation=correlation,
        nuisance=fitted.compared.rows(changes),
        nuisance_sd=spreads,
        beside=fitted.forces.nuisances(fitted.theta) if fitted.laxity.has_forces else None,
    )
    return best_fit_from(fitted.model, fitted.laxity, noise, [fitted.theta])


def stated_noise(laxity: Laxity) -> NoiseModel:
    """The stated noise, without nuisances.

    Raises
    ------
    ValueError
        If the data state none for a measured value.
    """
    sd = np.full(laxity.coordinates.shape, np.nan) if laxity.sd is None else laxity.sd
    return build_noise_model(sd, laxity.is_measured, correlation=laxity.within_trial_correlation)


def base_model(knee: Knee, protocol: Protocol) -> LaxityModel:
    """The model of a subject with its effects, its nuisances and the contact law as one more."""
    own = LaxityModel(knee=knee, protocol=protocol)
    if any(x.name == CONTACT_LAW for x in own.effects):
        return own
    return own.with_effects([contact_nuisance(), *own.effects])


@declared
class BaseFit:
    """The fit of the base model, and the noise found."""

    fitted: FittedModel = entry("The fit, nuisances among its errors")
    noise: DataNoise = entry("Errors of the data without nuisances")


def fit_low_loads(model: LaxityModel, laxity: Laxity, noise: NoiseModel, start: Array) -> Array:
    """The fit to trials of low loads, shape ``(p,)``: a way past parameters where the knee jumps.

    `start` itself where no trial has low loads.
    """
    size = np.abs(laxity.protocol.loads)
    largest = size.max(axis=0)
    low = np.all(size <= LOW_LOADS * np.where(largest > 0.0, largest, 1.0), axis=1)
    if laxity.zero != "absolute":
        return start
    part = laxity.select(low)
    rows = np.broadcast_to(low[:, None], laxity.is_measured.shape)[laxity.is_measured]
    if not part.is_measured.any():
        return start
    return np.array(best_fit_from(model.with_tests(part), part, noise.of(rows), [start]).theta)


# Share of the range of an amplitude: this close to an end it lies on it.
AT_END = 1e-3
# A rival this much less likely is excluded if it could be distinguished; beyond the second number
# whether it could or not.
NEAR_EVIDENCE, FAR_EVIDENCE = 6.0, 10.0
# What the score of a cause may be by chance, and its share of the highest score: below either a
# cause that could not be fitted would not have explained the data. Of 22 causes hidden one by one
# with a signal of 12 the true one had 0.72 of the highest score or more.
CHANCE, LEAST_SHARE = 0.05, 0.5


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Refit:
    """The model extended by causes, fitted again.

    Attributes
    ----------
    causes
        Effects beyond the base model, in the order in which they joined.
    fitted
        The fit.
    smooth
        Whitened patterns of smooth misfit, shape ``(m, k)``.
    noise_degrees
        Degrees of freedom of the noise.
    """

    causes: tuple[Effect, ...]
    fitted: FittedModel
    smooth: Array
    noise_degrees: float

    __repr__ = short_repr

    # Computed when it is first asked for: of the refits tried few are compared by it.
    @cached_property
    def log_evidence(self) -> float:
        """Logarithm of the evidence up to a constant of the data; -inf without a prediction."""
        found = self.fitted
        if not found.evaluation.is_finite:
            return -np.inf
        return log_evidence(found.evaluation, found.model.parameters, found.constrained.is_held)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(x.name for x in self.causes)

    @property
    def n_base(self) -> int:
        """Parameters of the model without causes; those of the causes come after them."""
        return self.fitted.model.parameters.n - sum(x.parameters.n for x in self.causes)

    @property
    def misfit_chi2(self) -> float:
        """Chi-square of the data and of the priors of nuisances and causes; inf without a fit.

        It is what would be left if ligaments were free of their priors. What a fit that ended
        before its minimum might still gain is added: it must not seem better than it is.
        """
        if not self.fitted.evaluation.is_finite:
            return np.inf
        left = self.fitted.misfit_projector.project(self.fitted.misfit_rows)
        rows = self.fitted.residual_rows()
        unfinished = rows - self.fitted.projector.project(rows)
        return float(left @ left + unfinished @ unfinished)

    @property
    def misfit_p_value(self) -> float:
        """Probability of so much misfit under noise: its size and its smooth part together."""
        return self.misfit_p_value_at(1.0)

    def misfit_p_value_at(self, factor: float) -> float:
        """Probability of so much misfit if noise were `factor` times as large; 0 unpredicted."""
        if not self.fitted.evaluation.is_finite:
            return 0.0
        rows, projector = self.fitted.misfit_rows / factor, self.fitted.misfit_projector
        square = self.misfit_chi2 / factor**2
        whole = chi2_or_f_test(square, projector.degrees_of_freedom, self.noise_degrees)
        wider = projector.with_columns(projector.padded(self.smooth))
        if wider.rank == projector.rank:
            return whole.p_value
        smooth = nested_check(rows, projector, wider, noise_degrees=self.noise_degrees)
        return cauchy_combination([whole.p_value, smooth.p_value])

    @property
    def pattern_p_value(self) -> float:
        """Probability under noise of what a cause that is not listed leaves behind another."""
        fitted, protocol = self.fitted, self.fitted.laxity.protocol
        rows, projector = fitted.misfit_rows, fitted.misfit_projector
        # Smooth in flexion and in each kind of load.
        errors = process_errors(
            protocol.loads, protocol.flexion_deg, fitted.laxity.is_measured, fitted.noise.sd
        )
        whitened = projector.padded(fitted.noise.whiten(errors))
        checks = [process_check(rows, projector, whitened, noise_degrees=self.noise_degrees)]
        # A wrench that acts in every trial, linear in flexion.
        model = fitted.model
        wrench = wrench_response(model, model.predict_once(fitted.theta))
        flexion = protocol.flexion_deg - protocol.flexion_deg.mean()
        changes = np.concatenate([wrench, flexion[:, None, None] * wrench], axis=2)
        wider = projector.with_columns(projector.padded(fitted.columns(changes)))
        if wider.rank > projector.rank:
            checks.append(nested_check(rows, projector, wider, noise_degrees=self.noise_degrees))
        return cauchy_combination([x.p_value for x in checks])

    def alarm_p_value(self, library_p_value: float, noise_factor: float = 1.0) -> float:
        """Probability of a misfit as clear under noise: library, size and shape together.

        The library's largest score is the sharpest of the three tests and counts three times as
        much.

        Parameters
        ----------
        library_p_value
            Probability of the largest score, which does not depend on the size of the noise.
        noise_factor
            Noise over the noise that the fit was made with.
        """
        return cauchy_combination([*3 * [library_p_value], self.misfit_p_value_at(noise_factor)])

    @property
    def predicted_reduction(self) -> float:
        """Further reduction of the deviance by the linear model; inf without a prediction."""
        evaluation = self.fitted.evaluation
        if not evaluation.is_finite:
            return np.inf
        free = ~self.fitted.constrained.is_held
        jacobian = evaluation.jacobian[:, free]
        gradient = jacobian.T @ evaluation.residuals
        return float(gradient @ np.linalg.solve(jacobian.T @ jacobian, gradient))

    def amplitudes(self, name: str) -> Array:
        """Fitted amplitudes of the cause called `name`."""
        return np.asarray(self.fitted.theta[self.places(name)])

    @property
    def extended_knee(self) -> Knee:
        """The subject whose model has the effects of the fit, each with the amplitudes found.

        An insertion found elsewhere is moved there. Ligaments keep the values that the subject came
        with: priors are centred on them, and data used for both prior and likelihood would count
        twice. A search starts at the fit with `fitted_values`.
        """
        model, p = self.fitted.model, self.fitted.model.parameters
        effects = [x for x in model.effects if not is_error_of_rig(x)]
        places = [[p.index(name) for name in x.parameters.names] for x in effects]
        values = [np.asarray(self.fitted.theta[x]) for x in places]
        return knee_with_effects(model.knee, list(zip(effects, values, strict=True)))

    @property
    def fitted_values(self) -> dict[str, dict[str, float]]:
        """All parameters by owner and name, as in a file of starts for `extended_knee`."""
        model = self.fitted.model
        found = values_by_owner(model.effects, model.parameters, self.fitted.theta)
        rigs = {x.name for x in model.effects if is_error_of_rig(x)}
        return {owner: values for owner, values in found.items() if owner not in rigs}

    def covariance(self) -> Array:
        """Covariance of all parameters, priors included, shape ``(p, p)``."""
        jacobian = self.fitted.evaluation.jacobian
        return np.asarray(np.linalg.inv(jacobian.T @ jacobian))

    def places(self, name: str) -> Array:
        """Where the amplitudes of the cause called `name` stand in theta."""
        cause = next(x for x in self.causes if x.name == name)
        return np.array([self.fitted.model.parameters.index(x) for x in cause.parameters.names])

    def is_at_range_end(self, name: str) -> bool:
        """Whether an amplitude lies at a non-zero end of its plausible range."""
        p, places = self.fitted.model.parameters, self.places(name)
        value, low, high = self.fitted.theta[places], p.lower[places], p.upper[places]
        margin = AT_END * (high - low)
        return bool(np.any((value > high - margin) | ((value < low + margin) & (low < 0.0))))


def without_causes(base: BaseFit) -> Refit:
    """The fit of the base model, the reference of comparisons."""
    fitted, protocol = base.fitted, base.fitted.laxity.protocol
    patterns = smooth_patterns(protocol.loads, protocol.flexion_deg, fitted.laxity.is_measured)
    return Refit(
        causes=(),
        fitted=fitted,
        smooth=fitted.noise.whiten(patterns),
        noise_degrees=base.noise.degrees_of_freedom,
    )


def refit(
    base: Refit,
    causes: Sequence[Effect],
    starts: Sequence[Array],
    *,
    most_steps: int = MOST_STEPS,
    beside: Sequence[Refit] = (),
    known: Sequence[Refit] = (),
) -> Refit:
    """The base model with these causes, fitted from `starts`, each of all its parameters.

    Parameters
    ----------
    base
        The fit without causes.
    causes
        The effects to add.
    starts
        Each shape ``(p,)``.
    most_steps
        Steps of each fit at most.
    beside
        Refits with the same causes: one that joins them is not continued.
    known
        Refits with the same causes, from whose ends fits begin.
    """
    model = base.fitted.model
    fitted = best_fit_from(
        model.with_effects([*model.effects, *causes]),
        base.fitted.laxity,
        base.fitted.noise,
        starts,
        most_steps=most_steps,
        ends=[x.fitted.evaluation for x in beside],
        known=[x.fitted.evaluation for x in known],
    )
    return replace(base, causes=tuple(causes), fitted=fitted)


def refit_of(base: Refit, causes: Sequence[Effect], constrained: ConstrainedFit) -> Refit:
    """The base model with these causes, where its fit is known."""
    model = base.fitted.model.with_effects([*base.fitted.model.effects, *causes])
    fitted = replace(base.fitted, model=model, constrained=constrained)
    return replace(base, causes=tuple(causes), fitted=fitted)


def refit_via_low_loads(base: Refit, stuck: Refit, start: Array) -> Refit:
    """A refit restarted from a fit to the trials of low loads."""
    fitted = stuck.fitted
    low = fit_low_loads(fitted.model, fitted.laxity, fitted.noise, start)
    return refit(base, stuck.causes, [low])


def expected_distance(true: Refit, rival: Refit) -> float:
    """How far the rival would stay from data that follow `true` without noise, in units of noise.

    The square is the chi-square that the rival's best fit to such data would leave, to first order
    around its own fit. Beyond 5 the rival would hardly ever be taken for the truth.
    """
    if not rival.fitted.evaluation.is_finite:
        return np.inf
    measured = rival.fitted.n_data
    difference = (
        rival.fitted.evaluation.residuals[:measured] - true.fitted.evaluation.residuals[:measured]
    )
    return float(np.linalg.norm(rival.fitted.projector.project(difference)))


class RivalState(StrEnum):
    """The state of another explanation given the data."""

    OPEN = "open"
    EXCLUDED = "excluded"
    NOT_TESTED = "not tested"


@declared
class Rival:
    """Another explanation."""

    refit: Refit = entry("The model with it")
    log_evidence_deficit: float = entry(
        "By how much the logarithm of its evidence is lower than that of the best explanation"
    )
    distance: float = entry("How well the data could distinguish both, see `expected_distance`")
    score: CandidateScore | None = entry(
        "Score of its cause that the best explanation lacks, before any refit; None where it lacks "
        "several"
    )
    highest: float = entry("The highest score of the same look")

    @property
    def state(self) -> RivalState:
        """Whether the data contradict it clearly enough, if it could be fitted at all.

        A fit that ended before its minimum is taken for as good as the linear model predicts that
        it may become: only what is excluded even so is excluded.
        """
        if self.refit.fitted.evaluation.is_finite and not (
            self.log_evidence_deficit > FAR_EVIDENCE
            or (self.log_evidence_deficit > NEAR_EVIDENCE and self.distance > LEAST_DISTANCE)
        ):
            return RivalState.OPEN
        undecided = is_undecided(self.refit, self.log_evidence_deficit)
        return RivalState.NOT_TESTED if undecided else RivalState.EXCLUDED

    @property
    def is_excluded(self) -> bool:
        """Whether the data exclude it."""
        return self.state is RivalState.EXCLUDED

    @property
    def could_matter(self) -> bool:
        """Whether it may be the explanation by its score."""
        return self.score is None or could_matter(self.score, self.highest)

    @property
    def reason(self) -> str:
        """The reason it was not tested, as a sentence; empty if it was."""
        if self.state is not RivalState.NOT_TESTED:
            return ""
        names = " and ".join(map(cause_label, self.refit.names))
        if not self.refit.fitted.evaluation.is_finite:
            why = "at no start did the model have an equilibrium in every measured trial"
        elif self.refit.fitted.outcome is Outcome.CLIFF:
            why = "the way to the best fit is cut where a trial leaves its branch"
        else:
            why = "the fit did not reach a minimum"
        sentence = f"The {names} could not be tested: {why}"
        if self.could_matter:
            return f"{sentence}."
        return f"{sentence}; the score before any fit is too low for the explanation."


def is_undecided(refit: Refit, deficit: float) -> bool:
    """Whether an explanation so far behind in evidence may still come near, its fit unfinished."""
    if not refit.fitted.evaluation.is_finite:
        return True
    if refit.fitted.outcome is Outcome.MINIMUM:
        return False
    return deficit - 0.5 * refit.predicted_reduction <= FAR_EVIDENCE


def could_matter(score: CandidateScore, highest: float) -> bool:
    """Whether a cause that was not fitted could still be the explanation, by its score alone."""
    return score.p_value <= CHANCE and score.score >= LEAST_SHARE * highest


def rivals_of(
    best: Refit, others: Sequence[Refit], looks: Sequence[tuple[Refit, Scores]]
) -> tuple[Rival, ...]:
    """The other explanations, each set of causes once, the most likely first.

    Parameters
    ----------
    best
        The best explanation.
    others
        Refits of others.
    looks
        The fits looked at, the base model first, with the scores beside each.
    """
    found: dict[frozenset[str], Refit] = {}
    for x in sorted(others, key=lambda x: -x.log_evidence):
        if set(x.names) != set(best.names):
            found.setdefault(frozenset(x.names), x)
    rivals = []
    for x in found.values():
        # The score of the one cause that `best` lacks, beside the others' if they were looked at.
        own, score, highest = set(x.names) - set(best.names), None, 0.0
        if len(own) == 1:
            beside = (scores for at, scores in looks if set(at.names) == set(x.names) - own)
            looked = next(beside, looks[0][1])
            score = next((y for y in looked.candidates if y.name in own), None)
            highest = looked.max_score
        rivals.append(
            Rival(
                refit=x,
                log_evidence_deficit=best.log_evidence - x.log_evidence,
                distance=expected_distance(best, x),
                score=score,
                highest=highest,
            )
        )
    return tuple(rivals)
