"""More load, more displacement its way, as long as no branch ends."""

import numpy as np
from energy_evaluation import SCALE, random_parameters
from hypothesis import given
from hypothesis import strategies as st

from identknee.laxity.protocol import LOADS, Protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array

# How far a coordinate moves at least between two steps of a ramp [mm], angles times 40 mm.
ROUNDING_MM = 1e-9
# Which coordinate of a pose each load works on, and which way.
WORKS_ON = {"internal_moment_Nm": (1, 1.0), "varus_moment_Nm": (0, 1.0)}
WORKS_ON |= {"anterior_force_N": (2, 1.0), "distraction_force_N": (3, -1.0)}
WORKS_ON |= {"lateral_force_N": (4, 1.0)}


def _ramp(column: str, flexion: float, size: float) -> Protocol:
    loads = np.zeros((9, 5))
    loads[:, LOADS.index(column)] = np.linspace(-size, size, 9)
    return Protocol(
        name="ramp",
        trials=tuple(f"step {i}" for i in range(9)),
        flexion_deg=np.full(9, flexion),
        loads=loads,
    )


def _along(prediction: Prediction, column: str) -> Array:
    index, sign = WORKS_ON[column]
    return np.asarray(sign * prediction.poses[:, index] * SCALE[index])


@given(
    column=st.sampled_from(LOADS),
    flexion=st.floats(0.0, 60.0),
    size=st.floats(0.5, 1.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_coordinate_grows_with_its_own_load(
    reference_model: LaxityModel, column: str, flexion: float, size: float, seed: int
) -> None:
    largest = 10.0 if column.endswith("Nm") else 150.0
    model = reference_model.with_protocol(_ramp(column, flexion, size * largest))
    theta = random_parameters(model, np.random.default_rng(seed), share=0.2, pct=1.0)
    found = model.predict(theta)
    steps = np.diff(_along(found, column))
    smooth = found.is_converged[1:] & found.is_converged[:-1]
    assert smooth.any()
    assert (steps[smooth] > ROUNDING_MM).all()


@given(trial=st.integers(0, 62), seed=st.integers(0, 2**32 - 1))
def test_compliance_is_positive_definite(
    reference_model: LaxityModel, trial: int, seed: int
) -> None:
    """Any small load at an equilibrium does positive work."""
    rng = np.random.default_rng(seed)
    single = reference_model.with_protocol(reference_model.protocol.select([trial]))
    found = single.predict(random_parameters(single, rng, share=0.5, pct=3.0))
    if found.all_converged:
        assert found.hessians is not None
        compliance = np.linalg.inv(found.hessians[0] / SCALE / SCALE[:, None])
        assert np.linalg.eigvalsh(0.5 * (compliance + compliance.T))[0] > 0.0
        load = rng.normal(size=5)
        assert load @ compliance @ load > 0.0
