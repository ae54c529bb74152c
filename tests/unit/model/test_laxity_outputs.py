"""Outputs of a laxity model in groups, some parameters held."""

from collections.abc import Iterable

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

from identknee.laxity.protocol import Protocol, from_zero
from identknee.laxity.table import COORDINATES
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import FreeParameters
from identknee.model.quantities import LaxityOutputs


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=small_knee(), protocol=small_protocol())


def names(n: int) -> tuple[str, ...]:
    return tuple(COORDINATES) * n


def free(model: LaxityModel, indices: Iterable[int]) -> FreeParameters:
    everything = model.parameters
    return FreeParameters(
        everything=everything, free_indices=tuple(indices), fixed_values=everything.center
    )


def test_outputs_are_the_coordinates_trial_after_trial(model: LaxityModel) -> None:
    theta = np.array(model.parameters.center)
    outputs = LaxityOutputs(model=model, groups=names(6), free=free(model, (1, 6)))
    assert outputs.parameters.names == ("back.stiffness_kN", "outer.reference_strain_pct")
    theta[[1, 6]] = 3.1, 5.5
    expected = model.predict(theta, derivatives=False).coordinates
    assert np.array_equal(outputs.evaluate(np.array([3.1, 5.5])), expected.ravel())


def test_outputs_may_be_changes_from_the_unloaded_pose(model: LaxityModel) -> None:
    protocol = small_protocol().select([0, 1])
    near = model.with_protocol(protocol)
    theta = np.array(near.parameters.center)
    outputs = LaxityOutputs(model=near, groups=names(2), free=free(near, range(8)), zero="unloaded")
    expected = from_zero(near.predict(theta).coordinates, protocol, "unloaded")
    assert np.array_equal(outputs.evaluate(theta), expected.ravel())
    assert np.all(outputs.evaluate(theta)[:5] == 0.0)
    with pytest.raises(ValueError, match="is unloaded at 8 deg"):
        LaxityOutputs(model=model, groups=names(6), free=free(model, (0,)), zero="unloaded")


def test_a_trial_without_equilibrium_is_nan(model: LaxityModel) -> None:
    strong = Protocol(
        name="strong",
        trials=("mild", "strong"),
        flexion_deg=np.zeros(2),
        loads=np.array([[0.1, 0, 0, 0, 0], [40.0, 0, 0, 0, 0]]),
    )
    outputs = LaxityOutputs(
        model=model.with_protocol(strong),
        groups=names(2),
        free=free(model, (0,)),
    )
    values = outputs.evaluate(np.array([2.0]))
    assert np.isfinite(values[:5]).all()
    assert np.isnan(values[5:]).all()


def test_every_output_needs_a_group(model: LaxityModel) -> None:
    with pytest.raises(ValueError, match="30 outputs need as many names of groups, got 2"):
        LaxityOutputs(model=model, groups=("a", "b"), free=free(model, (0,)))
