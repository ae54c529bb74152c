"""Tables whose coordinates are changes from the opposite load or from one trial."""

from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.laxity.protocol import (
    Protocol,
    from_zero,
    load_protocol,
    zero_of_added_trials,
    zero_trials,
)
from identknee.laxity.table import Laxity, laxity_rmse, read_laxity, write_laxity
from identknee.runs.errors import InputError

HEADER = "trial,flexion_deg,anterior_force_N,anterior_drawer_mm\n"
ROWS = "rest,0,0,\nanterior,0,100,{}\nposterior,0,-100,{}\nfar,60,100,\n"


def read(tmp_path: Path, zero: str, anterior: str, posterior: str = "", rest: str = "") -> Laxity:
    path = tmp_path / "table.csv"
    rows = ROWS.format(anterior, posterior).replace("rest,0,0,", f"rest,0,0,{rest}")
    path.write_text(f"# zero: {zero}\n{HEADER}{rows}")
    return read_laxity(path)


def test_changes_are_counted_from_the_opposite_load_or_from_a_trial(tmp_path: Path) -> None:
    protocol = read(tmp_path, "Opposite", "9").protocol
    values = np.array([1.0, 5.0, -4.0, 30.0])
    assert from_zero(values, protocol, "opposite").tolist() == [0.0, 9.0, -9.0, 0.0]
    assert from_zero(values, protocol, "rest").tolist() == [0.0, 4.0, -5.0, 29.0]
    deep = np.stack([values, 2.0 * values], axis=1)
    assert from_zero(deep, protocol, "rest")[:, 1].tolist() == [0.0, 8.0, -10.0, 58.0]
    with pytest.raises(ValueError, match=r"is called rest.* Keep it in the table"):
        zero_trials(protocol.select([1, 2]), "rest")


@pytest.mark.parametrize(("zero", "rest"), [("opposite", ""), ("rest", "0"), ("rest", "")])
def test_a_zero_is_read_and_written(tmp_path: Path, zero: str, rest: str) -> None:
    laxity = read(tmp_path, zero, "9.5", rest=rest)
    assert laxity.zero == zero
    again = read_laxity(write_laxity(laxity, tmp_path / "again.csv"))
    assert again.zero == zero
    np.testing.assert_array_equal(again.coordinates, laxity.coordinates)


@pytest.mark.parametrize(("zero", "cells", "said"), [
    ("opposite", ("9", "-9"), r"row 1: anterior and posterior both have .* twice\. Give it in the"),
    ("opposite", ("9", "", "1"), r"row 1: rest has coordinates, and no trial .* Add that trial"),
    ("rest", ("9", "", "0.5"), r"row 1: rest is the zero .* other than 0\. Leave its cells blank"),
    ("resting", ("9",), r"row 1: the zero 'resting' is unknown .* Write unloaded, opposite or the"),
])  # fmt: skip
def test_a_zero_that_cannot_be_is_refused(
    tmp_path: Path, zero: str, cells: tuple[str, ...], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, zero, *cells)


def changes(laxity: Laxity, zero: str) -> Laxity:
    """The table as a laboratory gives it whose coordinates have an unknown zero."""
    protocol: Protocol = laxity.protocol
    unknown = np.array([7.0, -3.0, 20.0, 4.0, 9.0])
    shifted = from_zero(laxity.coordinates + unknown, protocol, zero)
    loads = protocol.loads.sum(axis=1)
    shifted[loads <= 0.0] = np.nan
    return Laxity(protocol=protocol, coordinates=shifted, zero=zero)


@pytest.mark.parametrize("zero", ["opposite", "flexion30_unloaded"])
def test_a_model_is_compared_as_the_table_counts(zero: str) -> None:
    model = ik.LaxityModel(knee=ik.reference_knee(), protocol=load_protocol("seed63"))
    theta = model.parameters.center
    simulated = model.simulate(theta)
    table = changes(simulated, zero)
    problem = ik.LaxityResiduals(model=model, laxity=table)
    np.testing.assert_allclose(problem.residuals(theta), 0.0, atol=1e-9)
    slopes, step = problem.jacobian(theta)[:, 0], np.eye(len(theta))[0] * 1e-4
    ahead = problem.residuals(theta + step) - problem.residuals(theta - step)
    np.testing.assert_allclose(slopes, ahead / 2e-4, atol=1e-5)
    assert laxity_rmse(simulated, table).mm < 1e-9
    with pytest.raises(ValueError, match="Give the simulated one in absolute coordinates"):
        laxity_rmse(table, simulated)


def test_a_fit_finds_the_parameters_from_differences_alone() -> None:
    model = ik.LaxityModel(knee=ik.reference_knee(), protocol=load_protocol("seed63"))
    table = changes(model.simulate(model.parameters.center), "opposite")
    found = ik.fit("reference", table, start="IG3")
    np.testing.assert_allclose(found.search.theta, model.parameters.center, rtol=1e-4)
    assert len(found.trials_used) == int(table.is_measured.any(axis=1).sum())
    with pytest.raises(ValueError, match="--hold-out predicts absolute coordinates"):
        ik.fit("reference", table, hold_out=["flexion0*"])


def test_trials_to_add_are_counted_from_what_can_be_measured_beside_them() -> None:
    assert [zero_of_added_trials(x) for x in ("absolute", "unloaded", "opposite", "rest")] == [
        "absolute",
        *3 * ["unloaded"],
    ]
