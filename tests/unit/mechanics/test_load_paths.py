"""Paths of loads: small steps, shared nodes, one path a trial."""

import numpy as np
import pytest

from identknee.mechanics.equilibria import LoadPaths, load_paths
from identknee.runs.declare import Array

DEGREE = np.pi / 180.0
SLACK = 1.0 + 1e-9  # for the rounding of steps


def _loads(rows: list[list[float]]) -> Array:
    """Varus and internal moment [N m], forces along x, y, z [N]."""
    return np.array(rows) * [1000.0, 1000.0, 1.0, 1.0, 1.0]


def _path(paths: LoadPaths, trial: int) -> list[int]:
    """Nodes from the beginning to a trial."""
    nodes = [int(paths.trial_node[trial])]
    while paths.parent[nodes[-1]] >= 0:
        nodes.append(int(paths.parent[nodes[-1]]))
    return nodes[::-1]


@pytest.fixture
def random_trials() -> tuple[Array, Array]:
    rng = np.random.default_rng(5)
    loads = rng.uniform(-1.0, 1.0, (30, 5)) * [20.0, 20.0, 400.0, 900.0, 300.0]
    loads[rng.random((30, 5)) < 0.4] = 0.0
    return rng.uniform(-10, 120, 30) * DEGREE, _loads(loads.tolist())


def test_no_step_is_large(random_trials: tuple[Array, Array]) -> None:
    paths = load_paths(*random_trials, start_flexion=0.13)
    for node, parent in enumerate(paths.parent):
        if parent < 0:
            continue
        change = np.abs(paths.loads[node] - paths.loads[parent])
        assert change[:2].max() <= 2000.0 * SLACK
        assert change[2:].max() <= 50.0 * SLACK
        assert abs(paths.flexion[node] - paths.flexion[parent]) <= 10.0 * DEGREE * SLACK


def test_a_path_flexes_unloaded_then_loads_along_a_line(random_trials: tuple[Array, Array]) -> None:
    flexion, loads = random_trials
    paths = load_paths(flexion, loads, start_flexion=0.13)
    for trial in range(len(flexion)):
        nodes = _path(paths, trial)
        assert paths.flexion[nodes[0]] == 0.13
        assert paths.flexion[nodes[-1]] == pytest.approx(flexion[trial], abs=1e-15)
        assert paths.loads[nodes[-1]] == pytest.approx(loads[trial], abs=1e-9)
        loaded = np.abs(paths.loads[nodes]).max(axis=1) > 0.0
        first = int(np.argmax(loaded)) if loaded.any() else len(nodes)
        assert not loaded[:first].any()
        assert (paths.flexion[nodes][first:] == paths.flexion[nodes][-1]).all()
        share = paths.loads[nodes][first:] @ loads[trial] / max(loads[trial] @ loads[trial], 1e-9)
        on_line = share[:, None] * loads[trial]
        assert paths.loads[nodes][first:] == pytest.approx(on_line, abs=1e-9)
        assert (np.diff(share) > 0.0).all()


def test_parents_come_before_their_children(random_trials: tuple[Array, Array]) -> None:
    paths = load_paths(*random_trials, start_flexion=0.0)
    assert (paths.parent < np.arange(len(paths.parent))).all()
    assert (paths.parent == -1).sum() == 1


def test_replicates_and_lower_loads_share_nodes() -> None:
    flexion = np.array([30.0, 30.0, 30.0, 30.0]) * DEGREE
    loads = _loads([[10, 0, 0, 0, 0], [10, 0, 0, 0, 0], [4, 0, 0, 0, 0], [0, 0, 0, 0, 0]])
    paths = load_paths(flexion, loads, start_flexion=0.0)
    # Extension, 10, 20 and 30 deg, then 2, 4 ... 10 N m.
    assert len(paths.flexion) == 4 + 5
    assert paths.trial_node[0] == paths.trial_node[1]
    assert paths.trial_node[2] in _path(paths, 0)
    assert paths.trial_node[3] in _path(paths, 2)


def test_a_path_does_not_depend_on_the_other_trials(random_trials: tuple[Array, Array]) -> None:
    flexion, loads = random_trials
    whole = load_paths(flexion, loads, start_flexion=0.13)
    for trial in (0, 7, 29):
        alone = load_paths(flexion[[trial]], loads[[trial]], start_flexion=0.13)
        nodes = _path(whole, trial)
        np.testing.assert_array_equal(whole.flexion[nodes], alone.flexion[_path(alone, 0)])
        np.testing.assert_array_equal(whole.loads[nodes], alone.loads[_path(alone, 0)])


def test_in_a_single_step_every_trial_begins_anew(random_trials: tuple[Array, Array]) -> None:
    flexion, loads = random_trials
    paths = load_paths(flexion, loads, 0.13, "single-step")
    assert (paths.parent == -1).all()
    np.testing.assert_array_equal(paths.flexion[paths.trial_node], flexion)
    np.testing.assert_array_equal(paths.loads[paths.trial_node], loads)


def test_the_scanned_pose_itself_is_a_trial() -> None:
    paths = load_paths(np.array([0.13]), np.zeros((1, 5)), start_flexion=0.13)
    assert len(paths.flexion) == 1
    assert paths.parent.tolist() == [-1]


def test_flexion_and_loads_go_together() -> None:
    with pytest.raises(ValueError, match="longer than"):
        load_paths(np.zeros(2), np.zeros((3, 5)), start_flexion=0.0)
