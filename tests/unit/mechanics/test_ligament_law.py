"""Equation 3 of the paper, piece by piece."""

import numpy as np
import oracle
import pytest
from tolerances import CLOSED_FORM

from identknee.mechanics.elements import tension


@pytest.mark.parametrize("strain", [-0.3, -1e-9, 0.0])
def test_a_slack_line_carries_and_stores_nothing(strain: float) -> None:
    assert tension(strain, 8000.0, 0.03) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("strain", [1e-6, 0.01, 0.03, 0.06, 0.0600001, 0.1, 0.4])
def test_force_slope_and_stored_energy_are_the_oracles(strain: float) -> None:
    force, slope, stored = tension(strain, 8000.0, 0.03)
    assert force == pytest.approx(oracle.tension(strain, 8000.0, 0.03), rel=CLOSED_FORM)
    assert stored == pytest.approx(oracle.stored_energy(strain, 8000.0, 0.03), rel=CLOSED_FORM)
    by_step = oracle.tension(strain + 1e-30j, 8000.0, 0.03).imag / 1e-30
    assert slope == pytest.approx(by_step, rel=CLOSED_FORM)


def test_stiffness_is_the_slope_of_the_linear_part() -> None:
    ahead, behind = tension(0.2, 8000.0, 0.03)[0], tension(0.1, 8000.0, 0.03)[0]
    assert (ahead - behind) / 0.1 == pytest.approx(8000.0, rel=CLOSED_FORM)
    assert tension(0.2, 0.0, 0.03) == (0.0, 0.0, 0.0)
    assert np.isfinite(tension(50.0, 40000.0, 0.03)).all()
