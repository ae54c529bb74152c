"""A slack ligament carries nothing and is not missed."""

from dataclasses import replace

import numpy as np
from energy_evaluation import SCALE
from hypothesis import given, settings
from hypothesis import strategies as st
from tolerances import SAME_POSE

from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction


@given(
    which=st.integers(0, 3),
    stiffness=st.just(0.0) | st.floats(0.01, 40.0),
    slack=st.floats(-15.0, 0.0),
)
def test_what_is_slack_has_no_tension_and_no_slope(
    reference_model: LaxityModel, which: int, stiffness: float, slack: float
) -> None:
    """Both ways: no tension, no sensitivity; tension, a sensitivity."""
    theta = np.array(reference_model.parameters.center)
    theta[which], theta[4 + which] = stiffness, slack
    found = reference_model.predict(theta)
    tensions = tensions_of(reference_model, found)
    assert found.jacobian is not None
    for trial in np.flatnonzero(found.is_converged):
        for i in range(4):
            columns = np.abs(found.jacobian[trial][:, [i, 4 + i]]).max(axis=0)
            if tensions[trial, i] == 0.0:
                assert columns[0] == 0.0 or theta[i] == 0.0
                assert columns[1] == 0.0
            elif tensions[trial, i] > 1.0:
                assert (columns > 0.0).all()


@settings(max_examples=10)
@given(which=st.integers(0, 3), stiffness=st.floats(0.0, 40.0))
def test_where_it_is_slack_its_stiffness_does_not_matter(
    reference_model: LaxityModel,
    reference_prediction: Prediction,
    which: int,
    stiffness: float,
) -> None:
    """On the whole way to a trial, not only in it."""
    theta = np.array(reference_model.parameters.center)
    theta[which] = stiffness
    found = reference_model.predict(theta)
    slack = tensions_of(reference_model, reference_prediction)[:, which] == 0.0
    slack &= tensions_of(reference_model, found)[:, which] == 0.0
    difference = (found.poses - reference_prediction.poses) * SCALE
    assert np.abs(difference[slack]).max(initial=0.0) <= SAME_POSE


def test_a_ligament_that_is_always_slack_can_be_left_out(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    knee = reference_model.knee
    loose = replace(knee.ligaments[0], name="loose", reference_strain_pct=-60.0)
    more = LaxityModel(
        knee=knee.with_ligaments((*knee.ligaments, loose)), protocol=load_protocol("seed63")
    )
    found = more.predict(more.parameters.center)
    difference = (found.poses - reference_prediction.poses) * SCALE
    assert np.abs(difference).max() <= SAME_POSE
    assert not tensions_of(more, found)[:, 4].any()
    assert found.jacobian is not None
    assert not found.jacobian[:, :, [4, 9]].any()
