"""A smooth error of the model: found where the data have one, of the covariance that it says."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.discrepancy import SmoothDiscrepancy, smooth_discrepancy
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array

SD, VARUS = 0.3, COORDINATES.index("varus_deg")


def bent(size: float) -> tuple[LaxityResiduals, Array]:
    """Laxity whose varus bends with flexion and internal moment, as no ligament makes it."""
    model = LaxityModel(knee=small_knee(), protocol=load_protocol("seed63"))
    start = np.array(model.parameters.start)
    made = model.simulate(start)
    coordinates = made.coordinates + np.random.default_rng(4).normal(
        0.0, SD, made.coordinates.shape
    )
    flexion, loads = made.protocol.flexion_deg, made.protocol.loads
    turn = loads[:, 1] / np.abs(loads[:, 1]).max()
    coordinates[:, VARUS] += size * np.sin(flexion / 30.0) * (1.0 + turn)
    laxity = Laxity(
        protocol=made.protocol, coordinates=coordinates, sd=np.full_like(coordinates, SD)
    )
    return LaxityResiduals(model=model, laxity=laxity, weighting="noise"), start


def found_in(size: float, scales: tuple[float, float] = (1.0, 2.0)) -> SmoothDiscrepancy:
    compared, start = bent(size)
    return smooth_discrepancy(
        compared, -compared.residuals(start), compared.jacobian(start), scales
    )


def test_it_is_found_where_it_is() -> None:
    found = found_in(1.0)
    others = np.delete(found.sd, VARUS)
    # A sine of size 1 that is doubled and vanishes with the moment has a spread of about 0.8.
    assert 0.3 < found.sd[VARUS] < 3.0
    assert others.max() < 0.3 * found.sd[VARUS]
    assert found.words.count(",") == np.count_nonzero(found.sd) - 1
    assert found.words.split(", ")[VARUS] == f"varus_deg {found.sd[VARUS]:.2g}"


def test_noise_alone_leaves_it_within_the_noise() -> None:
    assert found_in(0.0).sd.max() < SD


def test_a_narrow_prior_holds_it_down() -> None:
    assert found_in(1.0, (1.0, 0.01)).sd[VARUS] < 0.1
    assert found_in(1.0, (1.0, 0.01)).sd[VARUS] < 0.2 * found_in(1.0).sd[VARUS]


def test_its_columns_have_the_covariance_of_its_sizes_and_lengths() -> None:
    found = found_in(1.0)
    protocol = load_protocol("seed63")
    flexion = protocol.flexion_deg / np.ptp(protocol.flexion_deg)
    largest = np.abs(protocol.loads).max(axis=0)
    loads = protocol.loads / np.where(largest > 0.0, largest, 1.0)
    covariance = np.einsum("aik,bjk->aibj", found.columns, found.columns)
    size = found.sd.max() ** 2
    kept = np.flatnonzero(bent(1.0)[0].laxity.is_measured.all(axis=1))
    for a, b in ((kept[0], kept[0]), (kept[1], kept[5]), (kept[4], kept[-1]), (kept[7], kept[20])):
        near = ((flexion[a] - flexion[b]) / found.flexion_length) ** 2
        near += np.sum((loads[a] - loads[b]) ** 2) / found.load_length**2
        expected = np.diag(found.sd**2) * np.exp(-0.5 * near)
        np.testing.assert_allclose(covariance[a, :, b], expected, atol=1e-6 * size)


def test_a_coordinate_not_measured_has_none() -> None:
    compared, start = bent(1.0)
    coordinates = np.array(compared.laxity.coordinates)
    coordinates[:, VARUS] = np.nan
    part = replace(compared.laxity, coordinates=coordinates)
    less = LaxityResiduals(model=compared.model, laxity=part, weighting="noise")
    found = smooth_discrepancy(less, -less.residuals(start), less.jacobian(start), (1.0, 2.0))
    assert found.sd[VARUS] == 0.0
    assert not found.columns[:, VARUS].any()
    assert "varus" not in found.words


def test_averaged_over_it_the_misfit_is_that_of_noise() -> None:
    compared, start = bent(1.0)
    found = found_in(1.0)
    averaged = replace(compared, shared=found.columns)
    n = compared.laxity.n_values
    plain, left = (float(np.sum(x.residuals(start) ** 2)) for x in (compared, averaged))
    assert plain > n + 8.0 * np.sqrt(2.0 * n)
    assert left == pytest.approx(n, abs=4.0 * np.sqrt(2.0 * n))
