"""Laxity that is linear in its parameters, with errors that trials share: all has a closed form."""

from dataclasses import dataclass

import numpy as np
from linear_data import everything
from linear_data import protocol as trials

from identknee.diagnosis.gain import Fold, Observations, held_out_folds
from identknee.diagnosis.noise_model import build_noise_model
from identknee.laxity.protocol import Protocol
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

SD = 0.3
N_VALUES = 315


def linear_protocol() -> Protocol:
    """The 63 trials: internal and varus moments at three angles."""
    flexion, loads, _ = trials()
    return Protocol(
        name="linear",
        trials=tuple(f"trial {i}" for i in range(len(flexion))),
        flexion_deg=flexion,
        loads=np.column_stack([loads, np.zeros((len(flexion), 3))]),
    )


def linear_folds() -> tuple[Fold, ...]:
    return held_out_folds(linear_protocol())


def linear_observations(*, n_nuisances: int = 4) -> Observations:
    """All values, whose errors are correlated within a trial and, by nuisances, between trials."""
    generator = np.random.default_rng(11)
    noise = build_noise_model(
        np.full((63, 5), SD),
        everything(),
        correlation=0.3,
        nuisance=generator.standard_normal((N_VALUES, n_nuisances)),
        nuisance_sd=np.full(n_nuisances, 0.1),
    )
    trial, coordinate = np.nonzero(everything())
    return Observations(
        trial=trial, coordinate=coordinate, sd=np.full(N_VALUES, SD), noise=noise, n_trials=63
    )


def smooth_columns(n: int, seed: int) -> Array:
    """Responses smooth in flexion and loads, different in each coordinate, shape ``(m, n)``."""
    flexion, loads, _ = trials()
    scaled = np.column_stack([flexion / 60, loads / 10])
    generator = np.random.default_rng(seed)
    terms = np.column_stack(
        [np.ones(63), scaled, np.abs(scaled), np.tanh(2 * scaled), scaled[:, :1] * scaled]
    )
    mixed = np.einsum("tk,kcn->tcn", terms, generator.standard_normal((terms.shape[1], 5, n)))
    return np.asarray(mixed.reshape(-1, n))


@dataclass(frozen=True, kw_only=True)
class LinearLaxity:
    """Residuals ``columns @ theta - measured`` with normal priors of one size."""

    columns: Array
    measured: Array
    prior_sd: float = 2.0
    lower: float = -50.0

    @property
    def parameters(self) -> Parameters:
        n = self.columns.shape[1]
        return Parameters(
            names=tuple(f"slope{i}" for i in range(n)),
            center=np.full(n, 0.5),
            lower=np.full(n, self.lower),
            upper=np.full(n, 50.0),
            prior_sd=np.full(n, self.prior_sd),
            is_log=np.zeros(n, bool),
        )

    def residuals(self, theta: Array) -> Array:
        return np.asarray(self.columns @ theta - self.measured)

    def jacobian(self, theta: Array) -> Array:
        assert theta.shape == (self.columns.shape[1],)
        return self.columns

    def fitted(self, observations: Observations) -> Array:
        """The most probable parameters, bounds left out of account."""
        whitened = observations.noise.whiten(self.columns)
        information = whitened.T @ whitened + np.eye(len(whitened.T)) / self.prior_sd**2
        right = whitened.T @ observations.noise.whiten(self.measured)
        right = right + self.parameters.center / self.prior_sd**2
        return np.asarray(np.linalg.solve(information, right))

    def marginal(self, observations: Observations) -> tuple[Array, Array]:
        """Mean and covariance of the measured values, the parameters integrated over."""
        mean = self.columns @ self.parameters.center
        spread = self.prior_sd**2 * self.columns @ self.columns.T
        return mean, spread + observations.noise.covariance


def drawn(columns: Array, theta: Array, observations: Observations, seed: int) -> LinearLaxity:
    """The problem whose data are those of `theta` with noise."""
    errors = np.random.default_rng(seed).standard_normal(len(columns))
    measured = columns @ theta + observations.noise.factor @ errors
    return LinearLaxity(columns=columns, measured=measured)
