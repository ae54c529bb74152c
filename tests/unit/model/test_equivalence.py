"""The paper's kinematic criterion as blocks of residuals."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.table import COORDINATES, laxity_rmse
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import PAPER_LIMITS, LaxityResiduals, rms_blocks


def test_blocks_are_mean_squares_over_their_limits(reference_model: LaxityModel) -> None:
    center = reference_model.parameters.center
    problem = LaxityResiduals(model=reference_model, laxity=reference_model.simulate(center))
    blocks = rms_blocks(problem)
    assert len(blocks) == 9
    assert "internal_deg@30" in blocks
    moved = center * 1.05
    difference = problem.residuals(moved) - problem.residuals(center)
    error = laxity_rmse(reference_model.simulate(moved), problem.laxity)
    for angle, row in zip(error.flexion_deg, error.by_flexion, strict=True):
        for name, limit in PAPER_LIMITS.items():
            value = np.sum((blocks[f"{name}@{angle:g}"] * difference) ** 2)
            rmse = row[COORDINATES.index(name)]
            assert value == pytest.approx((rmse / limit) ** 2, rel=1e-9)


def test_only_what_was_measured_counts(reference_model: LaxityModel) -> None:
    laxity = reference_model.simulate(reference_model.parameters.center)
    coordinates = np.array(laxity.coordinates)
    coordinates[:, COORDINATES.index("anterior_drawer_mm")] = np.nan
    coordinates[0] = np.nan
    problem = LaxityResiduals(
        model=reference_model, laxity=replace(laxity, coordinates=coordinates)
    )
    blocks = rms_blocks(problem)
    assert len(blocks) == 6
    assert np.count_nonzero(blocks["varus_deg@0"]) == 20
    assert np.count_nonzero(blocks["varus_deg@30"]) == 21


def test_what_cannot_be_meant_is_refused(reference_model: LaxityModel) -> None:
    laxity = reference_model.simulate(reference_model.parameters.center)
    problem = LaxityResiduals(model=reference_model, laxity=laxity)
    with pytest.raises(ValueError, match="limits are greater than 0"):
        rms_blocks(problem, {"varus_deg": 0.0})
    with pytest.raises(ValueError, match="limits are greater than 0"):
        rms_blocks(problem, {"varus": 1.0})
    noisy = replace(laxity, sd=np.ones_like(laxity.coordinates))
    with pytest.raises(ValueError, match='weighting="unit"'):
        rms_blocks(LaxityResiduals(model=reference_model, laxity=noisy, weighting="noise"))
    coordinates = np.full_like(laxity.coordinates, np.nan)
    coordinates[:, 0] = laxity.coordinates[:, 0]
    shifts = LaxityResiduals(model=reference_model, laxity=replace(laxity, coordinates=coordinates))
    with pytest.raises(ValueError, match="use the noise criterion"):
        rms_blocks(shifts)
