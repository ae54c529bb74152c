"""Planted misfit is found where it is, and noise points nowhere."""

import re

import numpy as np
import pytest
from linear_data import N_PARAMETERS, everything, linear_fit, protocol, unit_noise

from identknee.diagnosis.misfit import LEVEL, TrialLayout, localise
from identknee.diagnosis.noise_model import build_noise_model
from identknee.runs.declare import Array

FIT = linear_fit()
FLEXION, LOADS, _ = protocol()
NOISE = unit_noise()
COORDINATES = ("lateral shift", "drawer", "distraction", "varus", "internal rotation")
LAYOUT = TrialLayout(
    flexion_deg=FLEXION,
    loads=LOADS,
    directions=(("internal moment", "external moment"), ("varus moment", "valgus moment")),
    coordinates=COORDINATES,
    is_measured=everything(),
)
N_NULLS = 300
INVARIANT = 1e-9


def data(where: Array, coordinate: int, size: float, seed: int = 0) -> Array:
    shift = np.zeros((63, 5))
    shift[where, coordinate] = size
    noise = FIT.residuals(np.random.default_rng(seed), 1)[0]
    return np.asarray(noise + FIT.projector.padded(NOISE.whiten(shift[everything()])))


def test_one_cell_is_found_and_said() -> None:
    where = (FLEXION == 60) & (LOADS[:, 0] > 0)
    found = localise(data(where, 4, 6.0), FIT.projector, NOISE, LAYOUT, seed=1)
    assert len(found.cells) == 5 * 3 * 5
    assert len(found.region) == 1
    cell = found.region[0]
    assert (cell.coordinate, cell.flexion_deg) == ("internal rotation", 60.0)
    assert cell.score > 5
    assert 0.8 < found.share <= 1.0
    start = "internal rotation under internal moment at 60 deg, "
    assert found.sentence.startswith(start)
    assert f"{100 * found.share:.0f} %" in found.sentence


def places(sentence: str) -> list[tuple[list[str], list[str]]]:
    """The loads and the angles of each place that a sentence names."""
    region = sentence.partition(", ")[0]
    return [(re.findall(r"\b\w+ moment", x), re.findall(r"\b\d+\b", x)) for x in region.split("; ")]


def test_a_region_grows_over_angles_and_to_the_opposite_load() -> None:
    where = (FLEXION >= 30) & (LOADS[:, 1] != 0)
    found = localise(data(where, 3, -6.0), FIT.projector, NOISE, LAYOUT, seed=1)
    assert len(found.region) == 4
    assert all(x.score < 0 for x in found.region)
    (place,) = places(found.sentence)
    assert place == (["varus moment", "valgus moment"], ["30", "60"])
    assert found.sentence.startswith("varus ")


def test_places_that_differ_are_listed_apart() -> None:
    where = ((FLEXION == 30) & (LOADS[:, 0] != 0)) | ((FLEXION == 60) & (LOADS[:, 0] < 0))
    found = localise(data(where, 1, 6.0), FIT.projector, NOISE, LAYOUT, seed=1)
    assert places(found.sentence) == [
        (["internal moment"], ["30"]),
        (["external moment"], ["30", "60"]),
    ]
    assert found.sentence.startswith("drawer ")


def test_misfit_elsewhere_takes_its_share_of_the_excess() -> None:
    """Two separate cells, one with four times the squares of the other."""
    one = (FLEXION == 60) & (LOADS[:, 0] > 0)
    other = (FLEXION == 0) & (LOADS[:, 1] > 0)
    both = data(one, 4, 8.0) + data(other, 0, 4.0) - data(one, 4, 0.0)
    found = localise(both, FIT.projector, NOISE, LAYOUT, seed=1)
    assert [x.coordinate for x in found.region] == ["internal rotation"]
    assert found.share == pytest.approx(0.8, abs=0.1)


def test_the_share_is_what_falls_when_the_data_are_left_out() -> None:
    """By fits with and without them, less what would fall by chance."""
    where = (FLEXION == 60) & (LOADS[:, 0] > 0)
    residuals = data(where, 4, 3.0)
    found = localise(residuals, FIT.projector, NOISE, LAYOUT, seed=1)
    assert len(found.region) == 1
    rows = np.zeros((63, 5), dtype=bool)
    rows[where, 4] = True
    free = FIT.projector.padded(NOISE.whiten(np.eye(315)[:, rows.ravel()]))
    left = [
        residuals - x @ np.linalg.lstsq(x, residuals, rcond=None)[0]
        for x in (FIT.jacobian, np.hstack([FIT.jacobian, free]))
    ]
    before, after = (x @ x for x in left)
    expected = (before - after - 5) / (before - FIT.n_data)
    assert found.share == pytest.approx(min(expected, 1.0), rel=INVARIANT)


def test_what_the_parameters_explain_of_a_cell_is_allowed_for() -> None:
    """With a free mean of every coordinate and of one cell, scores still have variance 1."""
    means = NOISE.whiten(np.tile(np.eye(5), (63, 1)))
    cell = np.zeros((63, 5))
    cell[(FLEXION == 30) & (LOADS[:, 0] < 0), 2] = 1.0
    projector = FIT.projector.with_columns(np.column_stack([means, NOISE.whiten(cell.ravel())]))
    nulls = FIT.residuals(np.random.default_rng(5), 100)
    found = [localise(r, projector, NOISE, LAYOUT, seed=1) for r in nulls]
    assert len(found[0].cells) == 5 * 3 * 5 - 1
    scores = np.array([[x.score for x in one.cells] for one in found])
    assert np.mean(scores**2) == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
def test_noise_points_nowhere_as_often_as_stated() -> None:
    nulls = FIT.residuals(np.random.default_rng(2), N_NULLS)
    found = [localise(r, FIT.projector, NOISE, LAYOUT, seed=1) for r in nulls]
    rate = np.mean([bool(x.region) for x in found])
    assert rate == pytest.approx(LEVEL, abs=4 * np.sqrt(LEVEL * (1 - LEVEL) / N_NULLS))
    scores = np.array([[x.score for x in one.cells] for one in found])
    # Each variance over 300 draws is good to 8 %; the mean of 75 of them to 1 % or so.
    assert np.mean(scores**2) == pytest.approx(1.0, abs=0.05)
    silent = next(x for x in found if not x.region)
    assert silent.sentence.startswith("No region")


def test_which_near_equivalent_fit_was_found_does_not_matter() -> None:
    residuals = data((FLEXION == 60) & (LOADS[:, 0] > 0), 4, 6.0)
    moved = FIT.jacobian @ np.random.default_rng(3).normal(0, 5, N_PARAMETERS)
    one, other = (
        localise(x, FIT.projector, NOISE, LAYOUT, seed=1) for x in (residuals, residuals + moved)
    )
    for here, there in zip(one.cells, other.cells, strict=True):
        assert here.score == pytest.approx(there.score, abs=INVARIANT)
    assert one.share == pytest.approx(other.share, abs=INVARIANT)


def test_cells_without_data_are_left_out() -> None:
    measured = everything()
    measured[:, 4] = False
    layout = TrialLayout(
        flexion_deg=FLEXION,
        loads=LOADS,
        directions=LAYOUT.directions,
        coordinates=COORDINATES,
        is_measured=measured,
    )
    noise = build_noise_model(np.ones((63, 5)), measured, correlation=0.0)
    fit = linear_fit(n_data=252)
    residuals = fit.residuals(np.random.default_rng(4), 1)[0]
    found = localise(residuals, fit.projector, noise, layout, seed=1)
    assert len(found.cells) == 4 * 3 * 5
    with pytest.raises(ValueError, match=r"is_measured.*shape"):
        TrialLayout(
            flexion_deg=FLEXION,
            loads=LOADS,
            directions=LAYOUT.directions,
            coordinates=COORDINATES[:4],
            is_measured=measured,
        )


def test_the_p_value_of_a_cell_is_never_zero() -> None:
    """One of 4,001 where no draw of 4,000 is as high: the data are one more draw."""
    from identknee.diagnosis.misfit import N_DRAWS

    where = (FLEXION == 60) & (LOADS[:, 0] > 0)
    found = localise(data(where, 4, 40.0), FIT.projector, NOISE, LAYOUT, seed=1)
    assert found.region[0].p_value == pytest.approx(1.0 / (N_DRAWS + 1))
    assert min(x.p_value for x in found.cells) > 0.0
