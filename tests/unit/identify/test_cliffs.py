"""Cliffs are found on the path, to the edge, and named."""

from pathlib import Path

import numpy as np
import pytest
from landscapes import Quadrant, lost_sides

from identknee.identify.cliffs import EDGE, map_cliffs, plane
from identknee.runs.executors import process_pool
from identknee.runs.store import open_work

STARTS = np.array([[5.0, 0.0], [1.0, 5.0], [4.0, 4.0], [-6.0, 0.0]])


def test_the_edge_of_a_wall_is_found() -> None:
    found = map_cliffs(Quadrant(), STARTS, [0.0, 0.0], lost_at=lost_sides)
    assert found.has_cliff.tolist() == [True, False, True, False]
    lengths = np.abs(STARTS).sum(axis=1)
    for path, along in ((0, 0.4), (2, 0.5)):
        error = np.abs(found.edges[path] - along * STARTS[path]).sum()
        assert error <= EDGE * lengths[path]
        assert found.edges[path][0] <= 2.0
    # The mean over two parameters in %.
    assert found.edge_distances[0] == pytest.approx(1.0, abs=EDGE * 5)
    assert found.share_lost == pytest.approx([0.6, 0.0, 0.5, 0.0], abs=1 / 32)
    assert np.isnan(found.edges[1]).all()
    assert found.trials == ("right",)
    assert found.is_lost[:, 0].tolist() == [True, False, True, False]
    assert found.trials_lost == {"right": 2}


def test_workers_and_a_store_change_nothing(tmp_path: Path) -> None:
    alone = map_cliffs(Quadrant(), STARTS, [0.0, 0.0], lost_at=lost_sides)
    with open_work(tmp_path / "work.sqlite", {}) as store, process_pool(2) as executor:
        for _ in range(2):
            again = map_cliffs(
                Quadrant(),
                STARTS,
                [0.0, 0.0],
                lost_at=lost_sides,
                executor=executor,
                store=store,
            )
            assert np.array_equal(again.edges, alone.edges, equal_nan=True)
            assert np.array_equal(again.is_lost, alone.is_lost)


def test_a_target_beyond_a_cliff_is_refused() -> None:
    with pytest.raises(ValueError, match=r"prediction.*target"):
        map_cliffs(Quadrant(), STARTS, [3.0, 0.0])


def test_no_path_is_no_cliff() -> None:
    found = map_cliffs(Quadrant(), np.zeros((0, 2)), [0.0, 0.0])
    assert found.edges.shape == (0, 2)
    assert found.trials_lost == {}
    assert found.nearest_distance is None


def test_a_plane_shows_the_objective_and_where_it_is_lost() -> None:
    values, objectives = plane(Quadrant(), np.zeros(2), (0, 1), 7)
    assert values[0].tolist() == [-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0]
    assert np.isinf(objectives[:, 5:]).all()
    assert objectives[6, 1] == pytest.approx(0.5 * (16.0 + 36.0))
