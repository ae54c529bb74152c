"""What searches learn of the curvature that the linear model of the residuals leaves out."""

from typing import Protocol

import numpy as np

from identknee.runs.arrays import Array

# Of the product of their lengths: a step and the change of the gradient along it with a smaller
# product say nothing that an update could rest on.
LEAST_PRODUCT = 1e-8
# Of the largest eigenvalue: a direction with a smaller one is not moved along.
LEAST_EIGENVALUE = 1e-14


class Linearised(Protocol):
    """Residuals at a parameter vector, with their derivatives."""

    @property
    def theta(self) -> Array:
        """Where, shape ``(n,)``."""
        ...

    @property
    def residuals(self) -> Array:
        """In units of their noise, shape ``(m,)``."""
        ...

    @property
    def jacobian(self) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        ...


class Curvature:
    """The second derivatives of half the deviance beyond Gauss-Newton's, learned from points met.

    They are the sum of the residuals times their second derivatives. Where they are not small
    beside the squared Jacobian, as in the bent valleys of uncertain geometry, Gauss-Newton steps
    overshoot several times; a step that counts them lands where it means to. They are learned from
    the change of the gradient between points, in a least-change secant update that takes nothing of
    it which the Jacobian explains.

    Parameters
    ----------
    n
        Parameters.

    References
    ----------
    J. E. Dennis, D. M. Gay and R. E. Welsch, An adaptive nonlinear least-squares algorithm, ACM
    Trans. Math. Softw. 7 (1981) 348-368, section 3, doi:10.1145/355958.355965.
    """

    def __init__(self, n: int) -> None:
        self._matrix = np.zeros((n, n))

    @property
    def is_known(self) -> bool:
        """Whether anything has been learned."""
        return bool(self._matrix.any())

    def learn(self, before: Linearised, after: Linearised) -> None:
        """Take in what two points with derivatives say."""
        step = after.theta - before.theta
        gradient = after.jacobian.T @ after.residuals
        change = gradient - before.jacobian.T @ before.residuals
        wanted = gradient - before.jacobian.T @ after.residuals
        product = float(change @ step)
        scale = float(np.linalg.norm(after.jacobian @ step)) ** 2
        if product <= LEAST_PRODUCT * scale or scale == 0.0:
            return
        known = self._matrix @ step
        # What was learned elsewhere counts less where it has grown too large.
        size = float(abs(step @ known))
        share = min(1.0, float(abs(step @ wanted)) / size) if size > 0.0 else 1.0
        missing = wanted - share * known
        ratio = np.outer(missing, change) / product
        self._matrix = (
            share * self._matrix
            + ratio
            + ratio.T
            - float(missing @ step) / product**2 * np.outer(change, change)
        )

    def model(self, at: Linearised, scales: Array) -> tuple[Array, Array]:
        """Matrix and data whose sum of squares is the deviance around a point, up to a constant.

        In parameters divided by `scales`, shape ``(n,)``. A direction along which the deviance
        curves down counts as if it curved up as much, so that the lowest point of the model lies
        downhill and not at a saddle.
        """
        linear = at.jacobian * scales
        if not self.is_known:
            return linear, at.residuals
        square = linear.T @ linear + self._matrix * np.outer(scales, scales)
        values, vectors = np.linalg.eigh(square)
        sizes = np.abs(values)
        is_seen = sizes > LEAST_EIGENVALUE * sizes.max()
        roots = np.sqrt(np.where(is_seen, sizes, 1.0))
        slope = vectors.T @ (linear.T @ at.residuals)
        matrix = np.where(is_seen, roots, 0.0)[:, None] * vectors.T
        return matrix, np.where(is_seen, slope / roots, 0.0)
