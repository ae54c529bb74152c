"""Residuals without what a change of the fitted parameters could explain."""

from dataclasses import dataclass

import numpy as np

from identknee.runs.arrays import Array, frozen

# Of the largest singular value. Directions the data hardly see are kept on purpose: each costs one
# degree of freedom and makes every statistic indifferent to which near-equivalent fit was found.
LEAST_SINGULAR_VALUE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projector:
    """The projection onto what the fitted parameters cannot explain.

    Attributes
    ----------
    basis
        Orthonormal columns of what they can explain, shape ``(m, rank)``. The m rows are the
        whitened data, followed by the rows of the prior where there is one.
    """

    basis: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "basis", frozen(self.basis, None, None, name="basis"))

    @property
    def n_rows(self) -> int:
        """Rows, those of the prior included."""
        return len(self.basis)

    @property
    def rank(self) -> int:
        """How many directions are taken out."""
        return int(self.basis.shape[1])

    @property
    def degrees_of_freedom(self) -> int:
        """What is left for the residuals."""
        return self.n_rows - self.rank

    def padded(self, values: Array) -> Array:
        """`values` with rows of zeros for the prior where those rows are missing.

        Parameters
        ----------
        values
            Shape ``(m,)`` or ``(m, k)`` or, of the data rows alone, fewer rows.
        """
        missing = self.n_rows - len(values)
        return np.concatenate([values, np.zeros((missing, *values.shape[1:]))])

    def project(self, values: Array) -> Array:
        """What of `values` the fitted parameters cannot explain.

        Parameters
        ----------
        values
            As in `padded`.
        """
        rows = self.padded(values)
        projected: Array = rows - self.basis @ (self.basis.T @ rows)
        return projected

    def with_columns(self, columns: Array) -> "Projector":
        """The projector that takes out `columns` too, shape ``(m, k)`` as in `padded`."""
        # Twice, so that little is left of the basis also where little is left of a column.
        left = self.project(self.project(columns))
        new = _orthonormal(left, np.linalg.norm(columns, axis=0))
        return Projector(basis=np.hstack([self.basis, new]))


def base_projector(jacobian: Array) -> Projector:
    """The projector that belongs to a fit.

    Parameters
    ----------
    jacobian
        Derivatives of the whitened predictions by the fitted parameters, followed by the rows of
        their prior, ``[J; C0^(-1/2)]``, shape ``(m, p)``. Every direction is taken out whose
        singular value is more than 1e-6 of the largest, columns scaled to length 1.
    """
    nothing = Projector(basis=np.zeros((len(jacobian), 0)))
    return nothing.with_columns(jacobian)


def _orthonormal(columns: Array, sizes: Array) -> Array:
    """A basis of `columns`, each compared with the size it had before any projection."""
    seen = np.linalg.norm(columns, axis=0) > LEAST_SINGULAR_VALUE * sizes
    if not seen.any():
        return np.zeros((len(columns), 0))
    left, size, _ = np.linalg.svd(columns[:, seen] / sizes[seen], full_matrices=False)
    return np.asarray(left[:, size > LEAST_SINGULAR_VALUE * size[0]])
