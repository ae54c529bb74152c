import numpy as np

from identknee.calibrate.problem import floors, half_widths, typical_steps
from identknee.model.parameters import Parameters

PARAMETERS = Parameters(
    names=("A.stiffness_kN", "A.reference_strain_pct", "gain", "offset_Nm"),
    center=np.array([10.0, 2.0, 0.8, 0.0]),
    lower=np.array([0.0, -15.0, 0.1, -5.0]),
    upper=np.array([40.0, 15.0, 3.0, 5.0]),
    prior_sd=np.array([0.35, 2.0, 0.1, 0.5]),
    is_log=np.array([True, False, True, False]),
)


def test_half_widths_are_the_papers_and_two_sds_elsewhere() -> None:
    np.testing.assert_allclose(half_widths(PARAMETERS), [2.0, 3.0, 2 * 0.08, 1.0], rtol=1e-15)


def test_typical_steps() -> None:
    np.testing.assert_allclose(typical_steps(PARAMETERS), [3.0, 2.0, 0.08, 0.5], rtol=1e-15)


def test_floors() -> None:
    np.testing.assert_array_equal(floors(PARAMETERS), [0.0, -np.inf, 0.0, -np.inf])
