"""Linear-Gaussian nuisance parameters integrated out analytically: arrays only.

Residuals in units of their noise, ``r(theta, z) = r(theta) + S z + e`` with ``e ~ N(0, I)``, depend
linearly on nuisances ``z ~ N(0, P)``; in units of their prior standard deviations ``P = I``. Then

1. the residuals have the covariance ``V = I + S P S'``; whitened by the inverse of its Cholesky
   factor they are independent with variance 1 again (`marginal_covariance`, `whitening`);
2. the data leave the nuisances normal, with covariance ``C = (I + S' S)^-1`` and mean ``-C S' r``
   (`NuisancePosterior.after`);
3. the information about theta is ``J' V^-1 J = J'J - J'S C S'J``, the Schur complement of the
   nuisances' block in the information of both (`schur_complement`).

More data then see the nuisances as `NuisancePosterior` has them, in place of the prior. The same
holds to first order about a best fit where residuals are not linear.

References
----------
C. M. Bishop, Pattern Recognition and Machine Learning (2006), ISBN 978-0-387-31073-2, equations
2.115 (1), 2.116 and 2.117 (2) and 2.88 (3).
"""

from typing import NamedTuple, Self

import numpy as np

from identknee.runs.declare import Array, BoolArray


def marginal_covariance(
    slopes: Array, prior: Array | None = None, *, noise: Array | None = None
) -> Array:
    """Covariance of values with the nuisances integrated out, shape ``(..., m, m)``.

    Parameters
    ----------
    slopes
        Change of each value with each nuisance, shape ``(..., m, e)``.
    prior
        Covariance of the nuisances, shape ``(e, e)``; the identity if None.
    noise
        Covariance of the values without nuisances, shape ``(m, m)``; the identity if None.
    """
    own = np.eye(slopes.shape[-2]) if noise is None else noise
    weighted = slopes if prior is None else slopes @ prior
    return np.asarray(own + weighted @ slopes.mT)


def whitening(slopes: Array, prior: Array | None = None) -> Array:
    """The matrix that makes values in units of noise independent again, shape ``(..., m, m)``.

    Parameters as in `marginal_covariance`.

    Examples
    --------
    >>> whitening(np.array([[np.sqrt(3.0)], [0.0]])).round(12).tolist()
    [[0.5, 0.0], [0.0, 1.0]]
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(marginal_covariance(slopes, prior))))


def schur_complement(information: Array, is_kept: BoolArray) -> Array:
    """Information about the parameters kept, the others integrated out, shape ``(..., k, k)``.

    Parameters
    ----------
    information
        Of all parameters, priors of those integrated out included, shape ``(..., n, n)``.
    is_kept
        Which are kept, shape ``(n,)``.
    """
    kept, rest = np.flatnonzero(is_kept), np.flatnonzero(~is_kept)
    own, shared = (information[..., kept[:, None], x] for x in (kept, rest))
    within = information[..., rest[:, None], rest]
    return np.asarray(own - shared @ np.linalg.solve(within, shared.mT))


class NuisancePosterior(NamedTuple):
    """Normal posterior of the nuisances given data.

    Attributes
    ----------
    mean
        At q points of theta, less that at the first, shape ``(q, e)``.
    slope
        Derivatives of the mean by theta, shape ``(q, e, n)`` or ``(e, n)``.
    covariance
        Shape ``(e, e)``.
    """

    mean: Array
    slope: Array
    covariance: Array

    @classmethod
    def after(cls, residuals: Array, jacobians: Array, slopes: Array) -> Self:
        """The posterior of the nuisances given data.

        Parameters
        ----------
        residuals, jacobians
            Residuals at the points and their derivatives by theta, shapes ``(q, m)`` and ``(q, m,
            n)`` or ``(m, n)``.
        slopes
            Change of each residual with each nuisance, shape ``(m, e)``.
        """
        covariance = np.asarray(np.linalg.inv(np.eye(slopes.shape[1]) + slopes.T @ slopes), float)
        gain = -covariance @ slopes.T
        mean = (residuals - residuals[0]) @ gain.T
        return cls(mean=mean, slope=gain @ jacobians, covariance=covariance)

    def whitened(self, values: Array, jacobians: Array, slopes: Array) -> tuple[Array, Array]:
        """Values of k further trials whitened, with the nuisances integrated out.

        Parameters
        ----------
        values, jacobians
            Their values and derivatives at the points, shapes ``(q, k, m)`` and ``(q, k, m, n)``.
        slopes
            Change of each value with each nuisance, shape ``(k, m, e)``.
        """
        white = whitening(slopes, self.covariance)
        values = values + np.einsum("kme,qe->qkm", slopes, self.mean)
        jacobians = jacobians + np.einsum("kme,qen->qkmn", slopes, self.slope, optimize=True)
        return (
            np.einsum("kab,qkb->qka", white, values),
            np.einsum("kab,qkbn->qkan", white, jacobians, optimize=True),
        )

    def updated(self, value: Array, jacobian: Array, slopes: Array) -> Self:
        """The posterior given one more trial.

        Parameters
        ----------
        value, jacobian
            Its values and derivatives at the points, shapes ``(q, m)`` and ``(q, m, n)``; it says
            nothing where they are NaN.
        slopes
            Change of each value with each nuisance, shape ``(m, e)``.
        """
        spread = marginal_covariance(slopes, self.covariance)
        gain = np.linalg.solve(spread, slopes @ self.covariance).T
        value = np.nan_to_num(value + self.mean @ slopes.T)
        jacobian = np.nan_to_num(jacobian + slopes @ self.slope)
        return self._replace(
            mean=self.mean - value @ gain.T,
            slope=self.slope - gain @ jacobian,
            covariance=self.covariance - gain @ slopes @ self.covariance,
        )

    def rows(self, jacobians: Array, slopes: Array) -> Array:
        """Derivatives of further trials' values by theta, in units of their errors, ``(k, m, n)``.

        Parameters
        ----------
        jacobians
            Derivatives of the values of each of k trials by theta, shape ``(k, m, n)``.
        slopes
            Change of each value with each nuisance, shape ``(k, m, e)``.
        """
        return np.asarray(whitening(slopes, self.covariance) @ (jacobians + slopes @ self.slope))

    def information(self, jacobians: Array, slopes: Array) -> Array:
        """What each of k further trials adds to the information about theta, ``(k, n, n)``.

        Parameters as in `rows`.
        """
        rows = self.rows(jacobians, slopes)
        return np.asarray(rows.mT @ rows)


# Standard deviation of a nuisance after it is measured, as a share of its prior one.
SHARE = 0.5


def with_error_measured(n: int, places: list[int], prior_sd: Array | float = 1.0) -> Array:
    """A measurement of some parameters that narrows their priors to `SHARE`.

    Rows in units of that measurement's noise: its derivatives by all parameters.

    Parameters
    ----------
    n
        How many parameters there are.
    places
        Those measured, each directly.
    prior_sd
        Prior standard deviation of each of them.

    Returns
    -------
    rows
        Shape ``(len(places), n)``.

    Examples
    --------
    >>> row = with_error_measured(1, [0], prior_sd=2.0)
    >>> float(np.sqrt(1.0 / (2.0**-2 + row @ row.T))[0, 0])
    1.0
    """
    rows = np.zeros((len(places), n))
    rows[np.arange(len(places)), places] = np.sqrt(SHARE**-2 - 1.0) / prior_sd
    return rows
