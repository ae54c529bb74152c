"""Fits of the model extended by effects, and what compares them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.base_fit import MOST_STEPS, Fitted, fit_from
from identknee.diagnosis.goodness import cauchy_combination, nested_check, size_check
from identknee.diagnosis.projection import Projector, base_projector
from identknee.model.effects.effect import Effect
from identknee.runs.arrays import Array

# Of the range of an amplitude: this close to an end it lies on it.
AT_END = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    fitted: Fitted
    smooth: Array
    noise_degrees: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the causes."""
        return tuple(x.name for x in self.causes)

    @property
    def n_base(self) -> int:
        """Parameters of the model without causes; those of the causes come after them."""
        return self.fitted.model.parameters.n - sum(x.parameters.n for x in self.causes)

    @property
    def strain(self) -> float:
        """Misfit of the data and how far the base parameters left their prior, as a chi-square."""
        rows = self.fitted.evaluation.residuals[: self.fitted.n_data + self.n_base]
        return float(rows @ rows)

    @property
    def projector(self) -> Projector:
        """What the fitted parameters cannot explain."""
        return base_projector(self.fitted.evaluation.jacobian)

    @property
    def misfit_p_value(self) -> float:
        """Probability of so much misfit under noise: its size and its smooth part together."""
        return self.misfit_p_value_at(1.0)

    def misfit_p_value_at(self, factor: float) -> float:
        """The same if the noise were so many times as large; 0 without a prediction."""
        if not self.fitted.evaluation.is_finite:
            return 0.0
        rows, projector = self.fitted.residual_rows() / factor, self.projector
        # Not projected: a fit that ended before its minimum must not seem better than it is.
        whole = size_check(float(rows @ rows), projector.degrees_of_freedom, self.noise_degrees)
        wider = projector.with_columns(projector.padded(self.smooth))
        smooth = nested_check(rows, projector, wider, noise_degrees=self.noise_degrees)
        return cauchy_combination([whole.p_value, smooth.p_value])

    @property
    def log_evidence(self) -> float:
        """Logarithm of the evidence by Laplace's method, up to a constant of the data.

        Lognormal parameters count in their logarithm; amplitudes of one sign have half-normal
        priors.
        """
        evaluation, p = self.fitted.evaluation, self.fitted.model.parameters
        if not evaluation.is_finite:
            return -np.inf
        jacobian = evaluation.jacobian * np.where(p.is_log, evaluation.theta, 1.0)
        _, log_determinant = np.linalg.slogdet(jacobian.T @ jacobian)
        halves = int(np.sum(p.lower[~np.array(p.is_log)] == 0.0))
        return float(
            -0.5 * evaluation.deviance
            - 0.5 * log_determinant
            - np.log(p.prior_sd).sum()
            + halves * np.log(2.0)
        )

    @property
    def promised_fall(self) -> float:
        """What a straight model says the deviance would still fall by; inf without a prediction."""
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

    def covariance(self) -> Array:
        """Of all parameters, priors included, shape ``(p, p)``."""
        jacobian = self.fitted.evaluation.jacobian
        return np.asarray(np.linalg.inv(jacobian.T @ jacobian))

    def places(self, name: str) -> Array:
        """Where the amplitudes of the cause called `name` stand in theta."""
        names = self.fitted.model.parameters.names
        return np.array([i for i, x in enumerate(names) if x.startswith(f"{name}.")], dtype=int)

    def is_at_end(self, name: str) -> bool:
        """Whether an amplitude lies at an end of its plausible range other than zero."""
        p, places = self.fitted.model.parameters, self.places(name)
        value, low, high = self.fitted.theta[places], p.lower[places], p.upper[places]
        margin = AT_END * (high - low)
        return bool(np.any((value > high - margin) | ((value < low + margin) & (low < 0.0))))


def refit(
    base: Refit,
    causes: Sequence[Effect],
    starts: Sequence[Array],
    *,
    most_steps: int = MOST_STEPS,
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
        Of each fit.
    """
    model = base.fitted.model
    extended = model.with_effects([*model.effects, *causes])
    fitted = fit_from(
        extended, base.fitted.laxity, base.fitted.noise, starts, most_steps=most_steps
    )
    return Refit(
        causes=tuple(causes),
        fitted=fitted,
        smooth=base.smooth,
        noise_degrees=base.noise_degrees,
    )


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
    return float(np.linalg.norm(rival.projector.project(difference)))
