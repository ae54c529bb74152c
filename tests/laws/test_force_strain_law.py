"""The force-strain law is continuous with its slope, grows, and stores its own integral."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import CLOSED_FORM

from identknee.mechanics.elements import tension

stiffnesses = st.floats(1.0, 40000.0)
transitions = st.floats(0.005, 0.1)


@given(stiffness=stiffnesses, transition=transitions, joint=st.sampled_from([0.0, 2.0]))
def test_force_slope_and_store_are_continuous_where_the_pieces_meet(
    stiffness: float, transition: float, joint: float
) -> None:
    at, gap = joint * transition, 1e-9
    before, after = (
        tension(at - gap, stiffness, transition),
        tension(at + gap, stiffness, transition),
    )
    for i, size in enumerate((stiffness, stiffness / transition, stiffness)):
        assert abs(after[i] - before[i]) <= 2.0 * gap * size * (1.0 + 1e-6)


@given(stiffness=stiffnesses, transition=transitions, strain=st.floats(-0.5, 1.0))
def test_the_store_is_the_integral_of_the_force(
    stiffness: float, transition: float, strain: float
) -> None:
    """Gauss's rule on each piece, where it is exact."""
    ends = np.clip([0.0, 2.0 * transition, strain], 0.0, max(strain, 0.0))
    points, weights = np.polynomial.legendre.leggauss(3)
    integral = 0.0
    for low, high in zip(np.sort(ends)[:-1], np.sort(ends)[1:], strict=True):
        at = 0.5 * (high - low) * points + 0.5 * (high + low)
        forces = [tension(x, stiffness, transition)[0] for x in at]
        integral += 0.5 * (high - low) * float(weights @ forces)
    stored = tension(strain, stiffness, transition)[2]
    assert stored == pytest.approx(integral, rel=100 * CLOSED_FORM, abs=1e-12)


@given(stiffness=stiffnesses, transition=transitions, strain=st.floats(1e-3, 1.0))
def test_the_slope_is_that_of_the_force(stiffness: float, transition: float, strain: float) -> None:
    step = 1e-6
    ends = [tension(strain + s * step, stiffness, transition)[0] for s in (1.0, -1.0)]
    slope = tension(strain, stiffness, transition)[1]
    # Across the meeting of two pieces the difference errs by the change of slope over the step.
    bend = stiffness * step / transition
    assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(slope, rel=1e-6, abs=bend + 1e-4)


@given(
    stiffness=stiffnesses,
    transition=transitions,
    strains=st.tuples(st.floats(-0.2, 0.5), st.floats(-0.2, 0.5)),
    factor=st.floats(0.1, 10.0),
)
def test_it_grows_is_convex_and_scales_with_stiffness(
    stiffness: float, transition: float, strains: tuple[float, float], factor: float
) -> None:
    low, high = sorted(strains)
    first, second = tension(low, stiffness, transition), tension(high, stiffness, transition)
    assert first[0] <= second[0]
    assert first[1] <= second[1]
    assert min(first) >= 0.0
    scaled = tension(high, factor * stiffness, transition)
    assert scaled == pytest.approx(factor * np.array(second), rel=CLOSED_FORM)
