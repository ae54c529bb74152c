"""The fit of a laxity model to data, with everything diagnosis needs to know about it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.calibrate.bounded_least_squares import ConstrainedFit, minimise
from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.problem import ProblemWithPriors
from identknee.checks.fit_warnings import nuisance_findings
from identknee.diagnosis.data_noise import DataNoise, noise_of
from identknee.diagnosis.misfit import Projector, base_projector
from identknee.diagnosis.noise_model import NoiseModel, build_noise_model
from identknee.identify.nuisances import (
    NuisanceEstimate,
    NuisanceGroup,
    nuisance_estimates,
    nuisance_groups,
)
from identknee.identify.optimum import sobol_around
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.effects.library import values_of
from identknee.model.effects.tissues import CONTACT_LAW, contact_nuisance
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals, nuisance_changes
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee

N_STARTS = 3
# Prior standard deviations within which the other starts lie.
REACH = 1.0
# Tolerance on the deviance; the statistics that follow are known to a thousandth of a unit at best.
TOLERANCE = 1e-4
MOST_STEPS = 40
# Steps that find a valley, after which it is time to learn how it bends. Learned sooner, that leads
# to other minima.
STRAIGHT_STEPS = 12
# Share of the largest load of the data below which a knee seldom jumps.
LOW_LOADS = 0.5


@declared
class WhitenedProblem:
    """Residuals of a model whitened by a noise model, which may correlate trials."""

    compared: LaxityResiduals = entry("Model and data, compared in mm and deg")
    noise: NoiseModel = entry("The errors of the measured values")

    @property
    def parameters(self) -> Parameters:
        """Those of the model."""
        return self.compared.parameters

    def residuals(self, theta: Array) -> Array:
        """Predicted less measured, whitened, shape ``(m,)``; infinite without a prediction."""
        residuals = self.compared.residuals(theta)
        return self.noise.whiten(residuals) if np.isfinite(residuals).all() else residuals

    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m, p)``."""
        return self.noise.whiten(self.compared.jacobian(theta))


def whitened_problem(model: LaxityModel, laxity: Laxity, noise: NoiseModel) -> ProblemWithPriors:
    """The problem of fitting the model to the data, the priors of all parameters included."""
    compared = LaxityResiduals(model=model, laxity=laxity)
    return ProblemWithPriors(problem=WhitenedProblem(compared=compared, noise=noise))


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
    def n_data(self) -> int:
        """Values measured."""
        return int(self.laxity.is_measured.sum())

    @property
    def compared(self) -> LaxityResiduals:
        """Model and data, compared in mm and deg."""
        return LaxityResiduals(model=self.model, laxity=self.laxity)

    @property
    def nuisance_findings(self) -> tuple[Finding, ...]:
        """Nuisances whose estimate is improbable under their prior."""
        problem = whitened_problem(self.model, self.laxity, self.noise)
        return nuisance_findings(problem, self.theta, hint="")

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
    def nuisances(self) -> tuple[NuisanceEstimate, ...]:
        """The nuisance parameters of the knee at the fit."""
        return nuisance_estimates(whitened_problem(self.model, self.laxity, self.noise), self.theta)

    @property
    def nuisance_groups(self) -> tuple[NuisanceGroup, ...]:
        """How improbable those of each kind and place are under their prior; empty without any."""
        if self.model.parameters.is_of_interest.all():
            return ()
        return nuisance_groups(whitened_problem(self.model, self.laxity, self.noise), self.theta)

    @property
    def projector(self) -> Projector:
        """The projector off the fitted parameters."""
        return base_projector(self.evaluation.jacobian)

    def columns(self, changes: Array) -> Array:
        """Changes of the coordinates (n, 5, k), whitened, shape ``(m, k)``."""
        return self.noise.whiten(self.compared.rows(changes))


def best_fit_from(
    model: LaxityModel,
    laxity: Laxity,
    noise: NoiseModel,
    starts: Sequence[Array],
    *,
    most_steps: int = MOST_STEPS,
    ends: Sequence[Evaluation] = (),
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
    """
    problem, known, found = whitened_problem(model, laxity, noise), [*ends], list[ConstrainedFit]()
    for start in starts:
        found.append(_descended(problem, start, known, most_steps))
        if found[-1].outcome is Outcome.MINIMUM:
            known.append(found[-1].evaluation)
    best = min(found, key=lambda x: x.evaluation.deviance)
    return FittedModel(model=model, laxity=laxity, noise=noise, constrained=best)


def _descended(
    problem: ProblemWithPriors, start: Array, ends: Sequence[Evaluation], most_steps: int
) -> ConstrainedFit:
    """The fit from one start: in straight steps, then in some that know how the valley bends."""
    evaluator = Evaluator(problem, ends=ends)
    first = minimise(
        evaluator, start, tolerance=TOLERANCE, most_steps=min(STRAIGHT_STEPS, most_steps)
    )
    left = most_steps - STRAIGHT_STEPS
    if left <= 0 or first.outcome is not Outcome.VALLEY or first.n_simulations <= STRAIGHT_STEPS:
        return first
    evaluator = Evaluator(problem, ends=ends, learns_curvature=True)
    then = minimise(evaluator, first.evaluation.theta, tolerance=TOLERANCE, most_steps=left)
    return replace(then, n_simulations=first.n_simulations + then.n_simulations)


def fit_base(knee: Knee, laxity: Laxity, *, starts: Sequence[Array], seed: int) -> "BaseFit | None":
    """The base model's fit, its noise found on the way; None where the noise cannot be known.

    The base model is the subject's knee with the contact law as a nuisance: how stiff cartilage is
    and how its pressure grows is never known well, and must not pass for another cause.

    Parameters
    ----------
    knee, laxity
        The subject and the data.
    starts
        Ligament parameters to begin at besides the subject's own and Sobol points around those,
        each shape ``(2m,)``.
    seed
        Seed of those points.
    """
    model = base_model(knee, laxity.protocol).with_tests(laxity)
    n = model.n_ligament_parameters
    own = model.parameters.center[:n]
    stored = model.parameters.vector(values_of(knee))[n:]
    begin = [np.r_[x, stored] for x in (own, *starts, *_around(model, own, seed))]
    stated = noise_of(laxity, laxity.coordinates)
    if stated is None:
        return None
    plain = build_noise_model(stated.sd, laxity.is_measured, correlation=stated.correlation)
    begin.append(fit_low_loads(model, laxity, plain, begin[0]))
    fitted = best_fit_from(model, laxity, plain, begin)
    if not fitted.evaluation.is_finite:
        return BaseFit(fitted=fitted, noise=stated)
    noise = noise_of(laxity, fitted.compared.differences(fitted.theta))
    if noise is None:  # pragma: no cover - it was found before
        return None
    return BaseFit(fitted=fitted_with_nuisances(fitted, noise.sd, noise.correlation), noise=noise)


def fitted_with_nuisances(fitted: FittedModel, sd: Array, correlation: float) -> FittedModel:
    """A fit repeated from where it ended, with what nobody wants named among the errors.

    Parameters
    ----------
    fitted
        The fit without nuisances.
    sd
        Standard deviation of each value, shape ``(n, 5)``.
    correlation
        What the errors of a trial share.
    """
    changes, spreads = nuisance_changes(fitted.model, fitted.theta)
    noise = build_noise_model(
        sd,
        fitted.laxity.is_measured,
        correlation=correlation,
        nuisance=fitted.compared.rows(changes),
        nuisance_sd=spreads,
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


def _around(model: LaxityModel, start: Array, seed: int) -> list[Array]:
    """Points within a prior standard deviation of the subject's values around `start`."""
    p = model.parameters
    ligaments = p.select(p.names[: model.n_ligament_parameters])
    return list(sobol_around(ligaments, start, N_STARTS, reach=REACH, seed=seed))
