"""Moving both bones together, as another scan would, changes nothing."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from energy_evaluation import SCALE
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_knee import small_knee, small_protocol

from identknee.mechanics.distance_field import DistanceField
from identknee.model import laxity_model as joint
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array

# The grid of the distance field begins at the lowest vertex, which rounds: the spline differs by
# 1e-13 mm under contact of 1,000 N/mm, where margins are near 1 N/mm.
SAME_MM = 1e-9

turns = st.tuples(st.floats(-np.pi, np.pi), st.floats(-1.5, 1.5), st.floats(-np.pi, np.pi)).map(
    lambda angles: Rotation.from_euler("xyz", angles).as_matrix()
)
shifts = st.tuples(*[st.floats(-300.0, 300.0)] * 3).map(np.array)


@dataclass
class Still:
    """The knee where it was modelled, and what it answers."""

    model: LaxityModel
    prediction: Prediction
    built: list[DistanceField] = field(default_factory=list)


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Still]:
    cache = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint, "cache_folder", lambda: cache)
        model = LaxityModel(knee=small_knee(), protocol=small_protocol())
        yield Still(model=model, prediction=model.predict(model.parameters.center))


@settings(max_examples=8)
@given(rotation=turns, translation=shifts)
def test_a_moved_scan_gives_the_same_laxity(
    still: Still, rotation: Array, translation: Array
) -> None:
    knee = small_knee(rotation=rotation, translation=translation)
    model = LaxityModel(knee=knee, protocol=still.model.protocol)
    found = model.predict(model.parameters.center)
    assert found.outcomes == still.prediction.outcomes
    difference = (found.poses - still.prediction.poses) * SCALE
    assert np.abs(difference).max() <= SAME_MM
    tensions = tensions_of(model, found)
    assert tensions == pytest.approx(tensions_of(still.model, still.prediction), abs=1e-6)
    assert found.jacobian is not None
    assert still.prediction.jacobian is not None
    assert found.jacobian == pytest.approx(still.prediction.jacobian, rel=1e-6, abs=1e-7)


@given(rotation=turns, translation=shifts)
def test_a_moved_scan_is_the_same_joint(still: Still, rotation: Array, translation: Array) -> None:
    """Without the distance field, which takes its time: lengths, lines, points and the start."""
    knee = small_knee(rotation=rotation, translation=translation)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint, "_field", lambda *_: still.model.joint.field)
        moved = joint.contact_geometry(knee)
    here = still.model.joint
    rounding = 1e-12 * 300
    assert moved.contact.points == pytest.approx(here.contact.points, abs=rounding)
    assert moved.contact.areas == pytest.approx(here.contact.areas, abs=rounding)
    assert moved.lines.femoral == pytest.approx(here.lines.femoral, abs=rounding)
    assert moved.lines.tibial == pytest.approx(here.lines.tibial, abs=rounding)
    assert moved.lines.reference_length == pytest.approx(here.lines.reference_length, abs=rounding)
    assert moved.start == pytest.approx(here.start, abs=rounding)
    assert moved.start_flexion == pytest.approx(here.start_flexion, abs=rounding)
