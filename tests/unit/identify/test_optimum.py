"""The best of several fits, and starts that are refused."""

import numpy as np
import pytest
from problems import ClosedForm, plain_parameters, sloppy_springs

from identknee.identify.optimum import best_fit, best_fits
from identknee.runs.arrays import Array
from identknee.runs.record import Outcome

LEFT, RIGHT = -2.0, 2.0


def two_valleys() -> ClosedForm:
    """Minima near -2 and 2, the right one lower."""

    def residuals(x: Array) -> Array:
        return np.array([(x[0] - LEFT) * (x[0] - RIGHT), 0.3 * (x[0] - RIGHT)])

    return ClosedForm(
        name="two valleys",
        parameters=plain_parameters(1),
        start=np.array([-2.5]),
        minimum=np.array([RIGHT]),
        lowest=0.0,
        residuals_at=residuals,
        jacobian_at=lambda x: np.array([[2.0 * x[0]], [0.3]]),
    )


def test_the_other_starts_find_the_lower_valley() -> None:
    problem = two_valleys()
    found = best_fit(problem, start=problem.start)
    assert found.theta == pytest.approx([RIGHT], abs=1e-8)


def test_one_valley_is_found_from_the_centre() -> None:
    problem = sloppy_springs()
    assert best_fit(problem).theta == pytest.approx(problem.minimum, abs=1e-5)


def test_of_brief_fits_only_the_lowest_goes_on_to_its_end() -> None:
    problem = sloppy_springs()
    lowest, *others = best_fits(problem, budget=4)
    assert lowest.theta == pytest.approx(problem.minimum, abs=1e-5)
    assert {x.outcome for x in others} == {Outcome.BUDGET}
    assert max(x.n_simulations for x in others) == 4


def test_a_start_outside_the_bounds_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the start of x0\.value_pct is 11, outside its bounds"):
        best_fit(two_valleys(), start=np.array([11.0]))
