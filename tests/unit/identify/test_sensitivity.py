"""The verb: groups, failures, executors, resuming."""

import pickle
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from identknee.identify.sensitivity import FAILURE, Box, Sensitivity, box_around, sensitivity
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.runs.declare import Array
from identknee.runs.executors import process_pool, threads
from identknee.runs.store import open_work

SAME = 1e-10


def three_parameters() -> Parameters:
    return Parameters(
        names=("a", "b", "c"),
        center=np.zeros(3),
        lower=-np.ones(3),
        upper=np.ones(3),
        prior_sd=np.ones(3),
        is_log=np.zeros(3, bool),
    )


@dataclass(frozen=True)
class Linear:
    """Four outputs in three groups, without predictions where b is above `end`."""

    end: float = 2.0
    groups: tuple[str, ...] = ("near", "far", "near", "flat")
    parameters: Parameters = field(default_factory=three_parameters)

    def evaluate(self, theta: Array) -> Array:
        a, b, c = theta
        far = np.nan if b > self.end else 3.0 * b
        return np.array([a, far, 2.0 * a + c, 5.0])


BOX = Box(lower=-np.ones(3), upper=np.ones(3))
COVARIANCE = np.array([[1.0, 0.7, 0.0], [0.7, 1.0, 0.0], [0.0, 0.0, 1.0]])
DRAWS = np.random.default_rng(1).multivariate_normal(np.zeros(3), COVARIANCE, 600)


def same(one: Sensitivity, other: Sensitivity) -> bool:
    return all(
        np.array_equal(index.values, other.indices[name].values, equal_nan=True)
        and np.array_equal(index.half_widths, other.indices[name].half_widths, equal_nan=True)
        for name, index in one.indices.items()
    )


def test_groups_and_the_failure_come_back_in_order() -> None:
    found = sensitivity(Linear(), BOX, n_samples=256)
    assert found.groups == ("near", "far", "flat", FAILURE)
    assert found.n_samples == 256
    assert found.n_simulations == 256 * 5
    expected = np.array([[5 / 6, 0, 1 / 6], [0, 1, 0], [0, 0, 0], [0, 0, 0]])
    assert found.indices["ST"].final == pytest.approx(expected, abs=0.02)
    assert np.all(found.failed_share == 0.0)
    assert np.all(found.complete_share == 1.0)


def test_failures_are_an_output_with_indices_of_its_own() -> None:
    found = sensitivity(Linear(end=0.5), BOX, n_samples=1024)
    at = found.groups.index
    assert found.failed_share[at("far")] == pytest.approx(0.25, abs=0.01)
    assert found.failed_share[at(FAILURE)] == found.failed_share[at("far")]
    assert found.failed_share[at("near")] == 0.0
    # A block holds b of A and of B; neither may be beyond the end.
    assert found.complete_share[at("far")] == pytest.approx(0.75**2, abs=0.02)
    assert found.indices["ST"].final[at(FAILURE)] == pytest.approx([0.0, 1.0, 0.0], abs=0.05)
    assert np.isfinite(found.indices["S1"].final).all()
    assert "mean" in found.rule


def test_morris_by_group() -> None:
    found = sensitivity(Linear(end=0.9), BOX, method="morris", n_samples=32)
    star = found.indices["mu_star"].final
    expected = np.array([[3.0, 0.0, 1.0], [0.0, 6.0, 0.0], [0.0, 0.0, 0.0]])
    assert star[:3] == pytest.approx(expected, abs=SAME)
    assert star[3, 1] > 0.3
    assert star[3, [0, 2]] == pytest.approx([0.0, 0.0], abs=SAME)
    assert found.n_simulations == 32 * 4
    assert "neighbours" in found.rule


@pytest.mark.parametrize("method", ["delta", "pawn", "hdmr", "shapley"])
def test_draws_with_correlated_parameters(method: str) -> None:
    found = sensitivity(Linear(end=1.5), DRAWS, method=method)  # type: ignore[arg-type]
    assert found.box is None
    assert found.n_simulations == 600
    name = "ST" if method == "hdmr" else method
    index = found.indices[name]
    assert index.levels.tolist() == [300, 600]
    assert np.argmax(index.final[0]) == 0
    assert np.argmax(index.final[1]) == 1
    assert index.final[2] == pytest.approx([0.0, 0.0, 0.0])
    assert (index.noise_floor is not None) == (method in ("delta", "pawn"))
    assert found.component_share[1] == 1.0
    assert 0.8 < found.component_share[0] < 1.0
    # The first level leaves out failures too, and is then below the least number of draws.
    assert np.isnan(index.values[0, 1]).all()


def test_draws_from_a_box() -> None:
    found = sensitivity(Linear(), BOX, method="shapley", n_samples=400)
    assert found.n_samples == 400
    assert found.indices["shapley"].final[1] == pytest.approx([0.0, 1.0, 0.0], abs=0.01)


def test_what_is_missing_to_a_half_width() -> None:
    found = sensitivity(Linear(end=0.5), BOX, n_samples=64)
    width = found.largest_half_width[0]
    assert found.more_simulations(float(width))[0] == 0
    assert found.more_simulations(float(width) / 2)[0] == 3 * found.n_simulations
    with pytest.raises(ValueError, match=" 0, got 0"):
        found.more_simulations(0.0)
    lost = sensitivity(Linear(end=-2.0), BOX, n_samples=64)
    assert lost.failed_share[1] == 1.0
    assert np.isinf(lost.more_simulations()[1])
    effects = sensitivity(Linear(), BOX, method="morris", n_samples=8)
    assert effects.more_simulations() == pytest.approx(np.zeros(4))


@pytest.mark.slow
def test_the_executor_changes_nothing() -> None:
    one = sensitivity(Linear(end=0.5), BOX, n_samples=16)
    given = sensitivity(Linear(), DRAWS, method="shapley")
    with threads(2) as executor:
        assert same(one, sensitivity(Linear(end=0.5), BOX, n_samples=16, executor=executor))
    with process_pool(2) as executor:
        assert same(one, sensitivity(Linear(end=0.5), BOX, n_samples=16, executor=executor))
        again = sensitivity(Linear(), DRAWS, method="shapley", executor=executor)
    assert same(given, again)


@dataclass(frozen=True)
class Stops:
    """The same model, until it has been asked too often."""

    asked: list[int]
    most: int
    groups: tuple[str, ...] = Linear.groups
    parameters: Parameters = field(default_factory=three_parameters)

    def evaluate(self, theta: Array) -> Array:
        self.asked.append(1)
        if len(self.asked) > self.most:
            raise KeyboardInterrupt
        return Linear().evaluate(theta)


def test_a_stopped_run_resumes_and_grows(tmp_path: Path) -> None:
    path, about = tmp_path / "work.sqlite", {"model": "linear"}
    with open_work(path, about) as store, pytest.raises(KeyboardInterrupt):
        sensitivity(Stops(asked=[], most=42), BOX, n_samples=16, store=store)
    calls: list[int] = []
    with open_work(path, about) as store:
        found = sensitivity(Stops(asked=calls, most=1000), BOX, n_samples=16, store=store)
        assert len(calls) == 16 * 5 - 40
        more = sensitivity(Stops(asked=calls, most=1000), BOX, n_samples=32, store=store)
        assert len(calls) == 32 * 5 - 40
    assert same(found, sensitivity(Linear(), BOX, n_samples=16))
    assert same(more, sensitivity(Linear(), BOX, n_samples=32))


def test_one_set_of_draws_serves_several_methods(tmp_path: Path) -> None:
    calls: list[int] = []
    with open_work(tmp_path / "work.sqlite", {}) as store:
        for method in ("pawn", "shapley"):
            model = Stops(asked=calls, most=600)
            sensitivity(model, DRAWS, method=method, store=store)


def test_results_can_be_pickled() -> None:
    found = sensitivity(Linear(), BOX, n_samples=8)
    assert same(pickle.loads(pickle.dumps(found)), found)


def test_the_usual_box() -> None:
    parameters = ligament_parameters(["ACL", "new"], [10.0, 2.0], [8.0, -14.0])
    box = box_around(parameters, parameters.center)
    assert box.lower == pytest.approx([5.0, 1.0, 5.0, -15.0])
    assert box.upper == pytest.approx([15.0, 3.0, 11.0, -11.0])
    other = three_parameters().with_bounds({"a": (-9.0, 9.0)})
    assert box_around(other, np.zeros(3)).upper == pytest.approx([1.5, 1.0, 1.0])


def test_mistakes_are_named() -> None:
    with pytest.raises(ValueError, match=r"'sobl'.*sobol.*morris.*delta"):
        sensitivity(Linear(), BOX, method="sobl")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r'"morris".*independently'):
        sensitivity(Linear(), DRAWS, method="morris")
    with pytest.raises(ValueError, match=r"2 parameters.* 3"):
        sensitivity(Linear(), Box(lower=np.zeros(2), upper=np.ones(2)))
    with pytest.raises(ValueError, match="12 draws"):
        sensitivity(Linear(), DRAWS[:12], method="delta")
    with pytest.raises(ValueError, match=r"draws.* x 3"):
        sensitivity(Linear(), DRAWS[:, :2], method="delta")
