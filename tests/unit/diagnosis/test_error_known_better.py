"""What a stated error known twice as well does for telling explanations apart."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identknee.diagnosis.advice import measured_errors
from identknee.diagnosis.isolability import Pair, pair_distances
from identknee.model.effects.effect import amplitudes

PRIOR_SD, SIZE, STEEP = 2.0, 3.0, 1e4


def _explanation(value: float) -> Any:
    parameters = amplitudes("insertion", ["ACL_femur_x_mm"], [PRIOR_SD], upper=[25.0])
    model = SimpleNamespace(parameters=parameters.as_nuisances())
    fitted = SimpleNamespace(model=model, theta=np.array([value]))
    return SimpleNamespace(fitted=fitted, refit=SimpleNamespace(fitted=fitted))


def _distance(apart: float) -> tuple[float, float]:
    """Distance without and with the error known twice as well; it imitates the difference."""
    pair = Pair(
        effect=np.array([1]),
        amplitude=np.ones(1),
        rival=np.array([2]),
        rival_prior_sd=np.ones(1),
    )
    made = np.array([[STEEP, SIZE * STEEP, 0.0], [1.0 / PRIOR_SD, 0.0, 0.0]])
    best, rival = _explanation(apart), _explanation(0.0)
    ((name, rows),) = measured_errors(best, [rival], [pair], made.shape[1]).items()
    assert name == "insertion.ACL_femur"
    before, after = (
        float(pair_distances(x, [pair], n_base=1)[0]) for x in (made, np.vstack([made, rows]))
    )
    return before, after


def test_an_error_that_imitates_the_difference_costs_twice_as_much() -> None:
    before, after = _distance(0.0)
    assert before == pytest.approx(SIZE / PRIOR_SD, rel=1e-4)
    assert after == pytest.approx(2.0 * before, rel=1e-4)


def test_measuring_what_both_hold_alike_tells_nothing_more() -> None:
    """The rival moves its insertion by what it takes, and so comes to that of the other."""
    before, after = _distance(SIZE)
    assert after == pytest.approx(before, rel=1e-4)
