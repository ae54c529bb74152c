"""Global sensitivity of a model's outputs, over a box or over given draws."""

import base64
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np

from identknee.calibrate.problem import values_by_unit
from identknee.identify.sensitivity_estimators import (
    FEWEST_DRAWS,
    METHODS,
    OF_INDEX,
    Index,
    converging_indices,
    leading_component,
    morris_indices,
    sample_sizes,
    sobol_indices,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import OF_PARAMETER, Array, array, declared, derived, entry, frozen
from identknee.runs.executors import Executor, serial
from identknee.runs.store import Store, resumable_map

STIFFNESS_SHARE, STRAIN_PCT, PRIOR_SDS = 0.5, 3.0, 1.5
# With an even number of levels and steps over half of them every level is met equally often.
MORRIS_LEVELS = 4


@declared
class Box:
    """A uniform distribution over a box.

    Raises
    ------
    ValueError
        If a range is empty or not finite.
    """

    lower: Array = array("Lower ends", "parameter", unit=OF_PARAMETER, is_in_json=True)
    upper: Array = array("Upper ends", "parameter", unit=OF_PARAMETER, is_in_json=True)

    def __post_init__(self) -> None:
        width = self.upper - self.lower
        if not np.all(np.isfinite(width) & (width > 0)):
            worst = int(np.flatnonzero(~(np.isfinite(width) & (width > 0)))[0])
            raise ValueError(
                f"the range of parameter {worst + 1} is {self.lower[worst]:g} to "
                f"{self.upper[worst]:g}: its lower end must be below its upper end, both finite"
            )

    @property
    def n(self) -> int:
        """How many parameters there are."""
        return int(self.lower.size)

    def scaled(self, unit: Array) -> Array:
        """Points of the box from points of the unit cube, shape ``(..., n)``."""
        return np.asarray(self.lower + unit * (self.upper - self.lower))


def box_around(parameters: Parameters, center: Array) -> Box:
    """The usual box: stiffness +-50 %, reference strain +-3 %, other parameters +-1.5 prior sd."""
    sd = np.where(parameters.is_log, parameters.prior_sd * np.abs(center), parameters.prior_sd)
    reach = values_by_unit(parameters, STIFFNESS_SHARE * np.abs(center), STRAIN_PCT, PRIOR_SDS * sd)
    return Box(
        lower=np.maximum(center - reach, parameters.lower),
        upper=np.minimum(center + reach, parameters.upper),
    )


def saltelli_blocks(box: Box, n: int, seed: int) -> Array:
    """Blocks of a scrambled Saltelli design, shape ``(n, p + 2, p)``.

    A block is a point A, then p points with one coordinate each taken from a second point B, then
    B itself. The first blocks stay the same when n grows, so that more can be added.

    Raises
    ------
    ValueError
        If n is not a power of 2: the sequence is balanced only there.

    References
    ----------
    A. Saltelli et al., Computer Physics Communications 181 (2010) 259-270,
    doi:10.1016/j.cpc.2009.09.018.
    """
    if n < 2 or n & (n - 1):
        near = 2 ** max(1, round(np.log2(max(n, 2))))
        raise ValueError(f"Sobol indices need a power of 2 of blocks, got {n}; ask for {near}")
    # SALib imports pandas, which takes longer than many analyses.
    from SALib.sample import sobol

    points = sobol.sample(_cube(box.n), n, calc_second_order=False, seed=seed)
    return box.scaled(points.reshape(n, box.n + 2, box.n))


def morris_trajectories(box: Box, n: int, seed: int) -> Array:
    """Trajectories that change one parameter after the other, shape ``(n, p + 1, p)``.

    Raises
    ------
    ValueError
        If there are fewer than 2, which have no spread.

    References
    ----------
    M. D. Morris, Technometrics 33 (1991) 161-174, doi:10.1080/00401706.1991.10484804.
    """
    if n < 2:
        raise ValueError(f"elementary effects need at least 2 trajectories, got {n}")
    from SALib.sample import morris

    points = morris.sample(_cube(box.n), n, num_levels=MORRIS_LEVELS, seed=seed)
    return box.scaled(points.reshape(n, box.n + 1, box.n))


def box_draws(box: Box, n: int, seed: int) -> Array:
    """Independent draws from the box, shape ``(n, p)``; the first stay the same when n grows."""
    return box.scaled(np.random.default_rng(seed).random((n, box.n)))


def _cube(n: int) -> dict[str, object]:
    """A fresh description each time, because SALib writes into the one it is given."""
    return {
        "num_vars": n,
        "names": [f"x{i}" for i in range(n)],
        "bounds": [[0.0, 1.0] for _ in range(n)],
    }


Method = Literal["morris", "sobol", "delta", "pawn", "hdmr", "shapley"]
FAILURE = "failure"
TARGET = 0.02
DEFAULT_SAMPLES = {"sobol": 1024, "morris": 256}
DEFAULT_DRAWS = 2048
RULES = {
    "sobol": "an output without a prediction takes its mean over the simulations that have one",
    "morris": "every pair of neighbours that both have a prediction counts",
    "given": "the indices of a group use the draws at which all its outputs have a prediction",
}
# What the columns `complete` of the arrays count.
COMPLETE = {"sobol": "blocks", "morris": "trajectories"}


class Outputs(Protocol):
    """The outputs of a model as functions of theta, in groups."""

    @property
    def parameters(self) -> Parameters:
        """The parameters, in the order of theta."""

    @property
    def groups(self) -> tuple[str, ...]:
        """The group of each output, shape ``(m,)``; the outputs of a group share their unit."""

    def evaluate(self, theta: Array) -> Array:
        """The outputs at `theta`, shape ``(m,)``; NaN where one has no prediction."""


@declared
class Sensitivity:
    """The result of a global sensitivity analysis.

    The last group is ``"failure"``: 1 where any output has no prediction, 0 elsewhere, analysed as
    an output of its own.
    """

    method: Method = entry("Method: morris, sobol, delta, pawn, hdmr or shapley")
    parameters: Parameters = entry("The parameters", group="parameters", is_in_json=False)
    groups: tuple[str, ...] = array(
        "Names of the groups of outputs, failure last", "group", is_in_arrays=False
    )
    indices: Mapping[str, Index] = entry(
        "By name: S1 and ST, mu_star, mu and sigma, delta, pawn, Sa, Sb and ST, or shapley",
        rows="index",
        group="sensitivity",
        is_in_json=False,
    )
    failed_share: Array = array(
        "Share of the simulations in which an output of the group has no prediction", "group"
    )
    complete_share: Array = array(
        "Share of the blocks, trajectories or draws without such a failure", "group"
    )
    component_share: Array = array(
        "Share of the variance of each group's outputs that its analysed leading component has; 1 "
        "for Morris and Sobol, which use all outputs",
        "group",
    )
    n_samples: int = entry("Blocks, trajectories or draws", unit="1")
    n_simulations: int = entry("Parameter vectors simulated", unit="1")
    box: Box | None = entry("Where they lie; null for given draws", group="box")
    seed: int = entry("Seed of the design and the resampling")

    def __post_init__(self) -> None:
        if self.method == "morris" and "mu_star" not in self.indices:
            raise ValueError(f"a Morris analysis has the index mu_star, got {list(self.indices)}")

    @property
    @derived("What was done about simulations without a prediction", key="failures")
    def rule(self) -> str:
        if self.method not in COMPLETE:
            return self.rule_of_lost
        only = f"`complete` uses only {COMPLETE[self.method]} without any failure of the output"
        return f"{self.rule_of_lost}; {only}"

    @property
    def rule_of_lost(self) -> str:
        """The rule without the remark on `complete`, a column that only the arrays have."""
        return RULES.get(self.method, RULES["given"])

    @property
    @derived(
        "Share of the simulations with an output without prediction", unit="1", key="failed_share"
    )
    def share_failed(self) -> float:
        return float(self.failed_share[-1])

    @property
    @derived(
        "Largest half-width of any index of a group of outputs",
        unit=OF_INDEX,
        key="largest_half_width",
    )
    def worst_half_width(self) -> float:
        return float(self.largest_half_width[:-1].max())

    @property
    @derived(
        "Simulations still missing to a half-width of 0.02 in every group of outputs; null where "
        "none would do",
        unit="1",
        key="more_simulations_to_half_width_0.02",
    )
    def missing_simulations(self) -> float:
        """Simulations still missing; infinite where an index is unknown."""
        return float(self.more_simulations()[:-1].max())

    @property
    @derived(
        "By index and parameter: the largest value of any group of outputs, which group that is, "
        "and the index of failure",
        unit=OF_INDEX,
        key="indices",
    )
    def largest(self) -> dict[str, dict[str, dict[str, Any]]]:
        return {
            name: {
                parameter: {
                    "largest": {"value": float(values[top]), "group": self.groups[top]},
                    "of_failure": float(index.final[-1, i]),
                }
                for i, parameter in enumerate(self.parameters.names)
                for values in [index.final[:-1, i]]
                for top in [self.largest_group(name, i)]
            }
            for name, index in self.indices.items()
        }

    def largest_group(self, name: str, parameter: int) -> int:
        """Which group of outputs has the largest known value; the first where none is known."""
        values = self.indices[name].final[:-1, parameter]
        return int(np.argmax(np.where(np.isnan(values), -np.inf, values)))

    @property
    def largest_half_width(self) -> Array:
        """Largest half-width of any index of a group, shape ``(g,)``.

        For Morris as a part of the group's largest mean absolute effect. Infinite for a group whose
        indices are unknown.
        """
        widths = [x.final_half_widths.max(axis=1) for x in self.indices.values()]
        largest = np.max(np.where(np.isnan(widths), np.inf, widths), axis=0)
        if self.method != "morris":
            return np.asarray(largest)
        size = self.indices["mu_star"].final.max(axis=1)
        return np.asarray(np.where(size == 0.0, 0.0, largest / np.where(size > 0, size, 1.0)))

    def more_simulations(self, target: float = TARGET) -> Array:
        """Simulations still missing to a half-width of `target`, shape ``(g,)``.

        Half-widths shrink with the root of the number of samples. Infinite for a group whose
        indices are unknown.

        Raises
        ------
        ValueError
            If `target` is not above 0.
        """
        if not target > 0:
            raise ValueError(f"the half-width aimed at must be above 0, got {target:g}")
        times = np.maximum((self.largest_half_width / target) ** 2 - 1.0, 0.0)
        return np.asarray(np.ceil(self.n_simulations * times))


def sensitivity(
    outputs: Outputs,
    over: Box | Array,
    *,
    method: Method = "sobol",
    n_samples: int | None = None,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> Sensitivity:
    """Sensitivity of every group of outputs to every parameter, all from one set of simulations.

    Parameters
    ----------
    outputs
        The model; picklable if `executor` runs processes.
    over
        A box, or draws of theta, shape ``(n, p)``, for example from a posterior: thinned, in any
        order. Morris and Sobol need a box.
    method
        ``"morris"``: mean and spread of elementary effects, n (p + 1) simulations. ``"sobol"``:
        shares of variance, n (p + 2) simulations. ``"delta"`` and ``"pawn"``: distances between
        distributions. ``"hdmr"`` and ``"shapley"``: shares of variance among correlated parameters.
        The last four take n simulations and analyse the leading component of each group.
    n_samples
        Trajectories (256 if None), blocks (1,024) or draws from the box (2,048). With a larger
        number the same store goes on from what it holds. Given draws are all used.
    seed
        Of design, order and resampling.
    executor
        Anything with an ordered ``map``; the result does not depend on it.
    store
        Where finished simulations are kept; without one nothing is resumed.

    Raises
    ------
    ValueError
        If the method does not exist or does not fit `over`, there are too few draws, or the number
        of blocks is not a power of 2. Simulations without a prediction are no error.
    """
    points = _points(outputs, over, method, n_samples, seed)
    # Outputs at points (n, k, p), shape ``(n, k, m + 1)``, with 1 for a failure in the last.
    texts = resumable_map(
        partial(_packed_outputs, outputs),
        list(points),
        executor=executor,
        store=store,
        name=method if method in DEFAULT_SAMPLES else "draws",
        description="simulating",
    )
    flat = np.frombuffer(b"".join(base64.b64decode(x) for x in texts), dtype="<f8")
    values = flat.reshape(*points.shape[:2], len(outputs.groups))
    failed = ~np.isfinite(values).all(axis=2, keepdims=True)
    values = np.concatenate([np.where(np.isfinite(values), values, np.nan), failed], axis=2)
    # Names of the groups in order of appearance, and the group of every output and of failure.
    names = (*dict.fromkeys(outputs.groups), FAILURE)
    place = {name: i for i, name in enumerate(names)}
    groups = np.array([*(place[name] for name in outputs.groups), len(names) - 1])
    found: dict[str, Index]
    shares = np.ones(len(names))
    if method == "sobol":
        found = sobol_indices(values, groups, seed)
    elif method == "morris" and isinstance(over, Box):
        unit = (points - over.lower) / (over.upper - over.lower)
        found = morris_indices(unit, values, groups, seed)
    else:
        # The leading component of each group of outputs, and its share of the variance.
        n_groups, outputs_of = int(groups.max()) + 1, values[:, 0]
        found_of = [leading_component(outputs_of[:, groups == g]) for g in range(n_groups)]
        scores = np.column_stack([x for x, _ in found_of])
        shares = np.array([share for _, share in found_of])
        found = _given_indices(
            partial(converging_indices, method, points[:, 0], seed=seed),
            scores,
            executor=executor,
            store=store,
            name=f"{method} of {len(points)} draws",
        )
    # Whether a simulation lost an output of a group, shape ``(n, k, g)``; any, for failure.
    missing = np.isnan(values[:, :, :-1])
    by_group = [missing[:, :, groups[:-1] == g].any(axis=2) for g in range(int(groups.max()))]
    lost = np.stack([*by_group, values[:, :, -1] > 0], axis=2)
    return Sensitivity(
        method=method,
        parameters=outputs.parameters,
        groups=names,
        indices=found,
        failed_share=lost.mean(axis=(0, 1)),
        complete_share=1.0 - lost.any(axis=1).mean(axis=0),
        component_share=shares,
        n_samples=len(points),
        n_simulations=points.shape[0] * points.shape[1],
        box=over if isinstance(over, Box) else None,
        seed=seed,
    )


def _points(
    outputs: Outputs, over: Box | Array, method: str, n_samples: int | None, seed: int
) -> Array:
    """Parameter vectors to simulate, shape ``(n, k, p)``: n samples of k vectors."""
    known = (*DEFAULT_SAMPLES, *METHODS)
    if method not in known:
        raise ValueError(f"there is no method {method!r}; the methods are {', '.join(known)}")
    p = outputs.parameters.n
    if not isinstance(over, Box):
        if method in DEFAULT_SAMPLES:
            raise ValueError(
                f'"{method}" varies parameters independently and needs a box, not draws; use '
                f"one of {', '.join(METHODS)} for draws"
            )
        draws = _enough(frozen(over, None, p, name="draws"))
        # Draws of a chain are in its order; subsets of them should represent all of them.
        return np.random.default_rng(seed).permutation(draws)[:, None]
    if over.n != p:
        raise ValueError(f"the box has {over.n} parameters, the model {p}: give one range for each")
    n = DEFAULT_SAMPLES.get(method, DEFAULT_DRAWS) if n_samples is None else n_samples
    if method == "sobol":
        return saltelli_blocks(over, n, seed)
    if method == "morris":
        return morris_trajectories(over, n, seed)
    return _enough(box_draws(over, n, seed))[:, None]


def _enough(draws: Array) -> Array:
    if len(draws) < FEWEST_DRAWS:
        raise ValueError(
            f"{len(draws)} draws are too few for distributions: give at least {FEWEST_DRAWS}"
        )
    return draws


def _packed_outputs(outputs: Outputs, thetas: Array) -> str:
    """Outputs at each theta as base64 text, a third of the size of decimal digits."""
    values = np.array([outputs.evaluate(theta) for theta in thetas], dtype="<f8")
    return base64.b64encode(values.tobytes()).decode("ascii")


def _given_indices(
    indices: Callable[..., Mapping[str, Any]],
    scores: Array,
    *,
    executor: Executor,
    store: Store | None,
    name: str,
) -> dict[str, Index]:
    """Indices of each column of scores (n, g), a column a task."""
    levels = sample_sizes(len(scores), FEWEST_DRAWS)
    rows = resumable_map(
        partial(indices, levels=levels),
        list(scores.T),
        executor=executor,
        store=store,
        name=name,
        description=name,
    )
    found = {}
    for kind, first in rows[0].items():
        values, half_widths = (
            np.stack([np.array(row[kind][part]) for row in rows], axis=1)
            for part in ("values", "half_widths")
        )
        floor = [row[kind]["noise_floor"] for row in rows] if "noise_floor" in first else None
        found[kind] = Index(
            levels=levels,
            values=values,
            half_widths=half_widths,
            complete=values[-1],
            complete_half_widths=half_widths[-1],
            noise_floor=None if floor is None else np.array(floor),
        )
    return found
