"""How far one parameter set is from another, by ligament."""

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared


@declared
class ParameterError:
    """Absolute differences of a parameter set from another, over the ligaments."""

    stiffness_kN: Array = array("Error of the stiffness of each ligament", "ligament", unit="kN")  # noqa: N815 - the unit
    strain_pct: Array = array("Error of its reference strain", "ligament", unit="%")

    @property
    def mean_kN(self) -> float:  # noqa: N802 - the unit
        """Mean over the ligaments [kN]."""
        return float(self.stiffness_kN.mean())

    @property
    def sd_kN(self) -> float:  # noqa: N802 - the unit
        """Sample standard deviation over the ligaments [kN]."""
        return float(self.stiffness_kN.std(ddof=1))

    @property
    def mean_pct(self) -> float:
        """Mean over the ligaments [%]."""
        return float(self.strain_pct.mean())

    @property
    def sd_pct(self) -> float:
        """Sample standard deviation over the ligaments [%]."""
        return float(self.strain_pct.std(ddof=1))


def parameter_error(theta: ArrayLike, truth: ArrayLike) -> ParameterError:
    """Absolute differences of `theta` from `truth`, both stiffnesses first, shape ``(2 m,)``.

    Raises
    ------
    ValueError
        If the shapes differ or the length is odd.

    Examples
    --------
    >>> error = parameter_error([10.5, 18.0, 8.0, -4.5], [10.0, 18.0, 8.0, -4.0])
    >>> error.mean_kN, error.mean_pct
    (0.25, 0.25)
    """
    difference = np.abs(np.asarray(theta, float) - np.asarray(truth, float))
    if difference.ndim != 1 or difference.size % 2:
        raise ValueError(
            "theta must hold a stiffness and a reference strain for every ligament, "
            f"got shape {difference.shape}"
        )
    half = difference.size // 2
    return ParameterError(stiffness_kN=difference[:half], strain_pct=difference[half:])
