"""Tensions at many poses: those of the single pose, and slopes that differences confirm."""

import numpy as np
import pytest
from energy_evaluation import central_difference
from tolerances import CLOSED_FORM

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import (
    LigamentTensions,
    ligament_tensions,
    ligament_wrench,
)
from identknee.mechanics.pose import place
from identknee.runs.declare import Array

M, N, WITHOUT = 5, 7, 3
# Central differences of closed forms: rounding over a step of 1e-6, truncation below it.
SLOPE = 1e-7


@pytest.fixture(scope="module")
def case() -> dict[str, Array]:
    rng = np.random.default_rng(3)
    return {
        "femoral": rng.normal(0, 20, (M, 3)),
        "tibial": rng.normal(0, 20, (M, 3)) - [0, 30, 0],
        "flexion": rng.uniform(0, 2, N),
        "poses": rng.normal(0, [0.2, 0.4, 5, 5, 5], (N, 5)),
        "stiffness": rng.uniform(2e3, 2e4, M) * (np.arange(M) != WITHOUT),
        "strain": rng.uniform(-0.02, 0.08, M),
    }


def _lines(case: dict[str, Array]) -> LineLigaments:
    offset = case["tibial"] - case["femoral"]
    return LineLigaments(
        femoral=case["femoral"],
        tibial=case["tibial"],
        reference_length=np.linalg.norm(offset, axis=1),
    )


def _at(case: dict[str, Array], **changed: Array) -> LigamentTensions:
    now = case | changed
    return ligament_tensions(
        _lines(case), now["flexion"], now["poses"], now["stiffness"], now["strain"]
    )


def test_they_are_those_of_each_pose_alone(case: dict[str, Array]) -> None:
    found = _at(case)
    assert (found.tensions > 0).any()
    assert (found.tensions == 0).any()
    for i in range(N):
        alone = ligament_wrench(
            place(float(case["flexion"][i]), case["poses"][i]),
            _lines(case),
            case["stiffness"],
            case["strain"],
        )
        np.testing.assert_allclose(found.tensions[i], alone.tensions, rtol=CLOSED_FORM, atol=1e-9)


@pytest.mark.parametrize("column", range(5))
def test_slopes_by_the_pose_are_those_of_differences(case: dict[str, Array], column: int) -> None:
    def at(moves: Array) -> Array:
        return _at(case, poses=case["poses"] + moves).tensions

    expected = central_difference(at, np.zeros(5), column, 1e-6)
    error = np.abs(_at(case).by_pose[:, :, column] - expected)
    assert error.max() <= SLOPE * np.abs(expected).max()


@pytest.mark.parametrize("name", ["stiffness", "strain"])
def test_slopes_by_the_parameters_are_those_of_differences(
    case: dict[str, Array], name: str
) -> None:
    found = _at(case)
    exact = found.by_stiffness if name == "stiffness" else found.by_strain
    step = 1.0 if name == "stiffness" else 1e-7
    for ligament in range(M):

        def at(values: Array) -> Array:
            return _at(case, **{name: values}).tensions

        expected = central_difference(at, case[name], ligament, step)
        others = np.arange(M) != ligament
        assert not expected[:, others].any()
        size = max(float(np.abs(expected).max()), 1.0)
        assert np.abs(exact[:, ligament] - expected[:, ligament]).max() <= SLOPE * size


def test_without_stiffness_there_is_no_tension_but_a_slope_by_it(case: dict[str, Array]) -> None:
    found = _at(case)
    assert not found.tensions[:, WITHOUT].any()
    assert found.by_stiffness[:, WITHOUT].any()
