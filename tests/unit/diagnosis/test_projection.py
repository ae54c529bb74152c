"""What the fitted parameters explain is taken out, all of it and nothing else."""

import numpy as np
from linear_data import N_PARAMETERS, linear_fit

from identknee.diagnosis.misfit import base_projector

# Rounding of products of a few hundred terms of size 1 to 10.
ROUNDING = 1e-12


def test_changes_of_the_parameters_leave_nothing() -> None:
    fit = linear_fit()
    moved = fit.jacobian @ np.random.default_rng(1).standard_normal(N_PARAMETERS)
    np.testing.assert_allclose(fit.projector.project(moved), 0.0, atol=ROUNDING)
    assert fit.projector.rank == N_PARAMETERS
    assert fit.projector.degrees_of_freedom == fit.n_data


def test_what_is_orthogonal_stays() -> None:
    fit = linear_fit()
    once = fit.projector.project(np.random.default_rng(2).standard_normal((323, 3)))
    np.testing.assert_allclose(fit.projector.project(once), once, atol=ROUNDING)


def test_sloppy_directions_are_taken_out_and_dead_columns_are_not_counted() -> None:
    """A direction seen a hundred thousand times less counts; units of a column do not."""
    generator = np.random.default_rng(3)
    stiff = generator.standard_normal((40, 2))
    sloppy = stiff[:, :1] + 1e-5 * generator.standard_normal((40, 1))
    jacobian = np.hstack([stiff, sloppy, np.zeros((40, 1))])
    projector = base_projector(jacobian)
    assert projector.rank == 3
    assert base_projector(jacobian * [1e9, 1.0, 1e-9, 1.0]).rank == 3
    assert base_projector(np.hstack([stiff, 2 * stiff])).rank == 2


def test_data_rows_are_padded_for_the_prior() -> None:
    fit = linear_fit()
    values = np.random.default_rng(4).standard_normal((fit.n_data, 2))
    padded = fit.projector.padded(values)
    np.testing.assert_array_equal(padded[fit.n_data :], 0.0)
    np.testing.assert_array_equal(fit.projector.project(values), fit.projector.project(padded))


def test_further_columns_are_taken_out_too() -> None:
    fit = linear_fit()
    columns = np.random.default_rng(5).standard_normal((fit.n_data, 3))
    wider = fit.projector.with_columns(columns)
    assert wider.rank == N_PARAMETERS + 3
    np.testing.assert_allclose(wider.project(columns), 0.0, atol=ROUNDING)
    np.testing.assert_allclose(wider.project(fit.jacobian), 0.0, atol=ROUNDING)
    assert wider.with_columns(fit.jacobian[:, :2]).rank == wider.rank
