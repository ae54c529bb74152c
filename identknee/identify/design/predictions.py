"""The trials that might be added, predicted wherever the data allow the parameters to be."""

from collections.abc import Sequence

import numpy as np

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import Problem
from identknee.calibrate.quantity import Quantity
from identknee.identify.design.added_trials import Candidates
from identknee.identify.design.criteria import Loss, Path, directions_across
from identknee.identify.information.information import scaled_units
from identknee.identify.profile.result import Profile
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import declared, derived, entry
from identknee.runs.executors import Executor


@declared
class Excluded:
    """A candidate that is not offered, and why."""

    name: str = entry("Name of the trial", key="trial")
    failures: int = entry(
        "Parameter sets that the data allow at which it has no prediction", unit="1"
    )
    tried: int = entry("Parameter sets at which it was predicted", unit="1")
    at_fit: bool = entry("Whether it has no prediction at the best fit")

    @property
    @derived("Why it is not offered", key="reason")
    def sentence(self) -> str:
        """Why, in a sentence."""
        if self.at_fit:
            return f"{self.name} has no prediction at the best fit."
        return (
            f"{self.name} has no prediction at {self.failures} of {self.tried} parameter sets that "
            "the data allow."
        )


@declared
class CandidatePredictions:
    """The candidates at the best fit and along the profiles: q points, k trials, n parameters.

    Attributes
    ----------
    thetas
        The points, the first of them the best fit, shape ``(q, n)``.
    is_likely
        Which of them the data allow, shape ``(q,)``.
    values, jacobians
        What the trials would measure, in units of the noise, shape ``(q, k, m)``, and its
        derivatives by the scaled parameters, ``(q, k, m, n)``; NaN where there is no prediction.
    information
        That of the trials made, for the scaled parameters, shape ``(q, n, n)``.
    scales
        One scaled unit of each parameter, shape ``(n,)``.
    """

    thetas: Array
    is_likely: BoolArray
    values: Array
    jacobians: Array
    information: Array
    scales: Array

    @property
    def n_simulations(self) -> int:
        """At each point one of the trials made and one of the candidates."""
        return 2 * len(self.thetas)

    def excluded(self, names: tuple[str, ...]) -> tuple[Excluded, ...]:
        """Candidates without a prediction at a point that the data allow."""
        known: BoolArray = np.asarray(
            np.isfinite(self.values).all(axis=2) & np.isfinite(self.jacobians).all(axis=(2, 3))
        )
        failures = (~known & self.is_likely[:, None]).sum(axis=0)
        return tuple(
            Excluded(
                name=names[i],
                failures=int(failures[i]),
                tried=int(self.is_likely.sum()),
                at_fit=not known[0, i],
            )
            for i in np.flatnonzero(failures)
        )

    def features(self, loss: Loss, allowed: BoolArray) -> tuple[Array, Array]:
        """Features of the trials made, shape ``(f,)``, and of the candidates, ``(k, f)``.

        Zero for those excluded.
        """
        offered = loss.of_trials(self.values[:, allowed], self.jacobians[:, allowed])
        trials = np.zeros((len(allowed), offered.shape[1]))
        trials[allowed] = offered
        return loss.of_made(self.information), trials


def predict_candidates(
    problem: Problem, before: Sequence[Profile], candidates: Candidates, executor: Executor
) -> CandidatePredictions:
    """The candidates predicted at the best fit and along the profiles."""
    scales = scaled_units(problem.parameters, "typical")
    thetas = np.vstack([before[0].optimum, *(profile.thetas for profile in before)])
    likely = [profile.deltas <= profile.threshold for profile in before]
    rows = list(executor.map(_PointPrediction(problem=problem, candidates=candidates), thetas))
    return CandidatePredictions(
        thetas=thetas,
        is_likely=np.concatenate([[True], *likely]),
        values=np.array([x[1] for x in rows]),
        jacobians=np.array([x[2] for x in rows]) * scales,
        information=np.array([x[0] for x in rows]) * np.outer(scales, scales),
        scales=scales,
    )


@declared
class _PointPrediction:
    """Information of the trials made and predictions of all candidates at one theta."""

    problem: Problem
    candidates: Candidates

    def __call__(self, theta: Array) -> tuple[Array, Array, Array]:
        everything = range(len(self.candidates.names))
        return (
            evaluate(self.problem, theta).information,
            *self.candidates.predict(theta, everything),
        )


def paths_of(
    before: Sequence[Profile], quantities: Sequence[Quantity], scales: Array
) -> tuple[Path, ...]:
    """The profiles as `WidthLoss` takes them, their points in the order of the predictions."""
    paths, first = [], 1
    for profile, quantity in zip(before, quantities, strict=True):
        places = np.arange(first, first + len(profile.values))
        first += len(profile.values)
        gradients = np.array([quantity.evaluate(theta)[1] for theta in profile.thetas])
        paths.append(
            Path(
                places=places,
                values=profile.values,
                deltas=profile.deltas,
                across=directions_across(gradients * scales),
                center=profile.optimum_value,
                threshold=profile.threshold,
            )
        )
    return tuple(paths)
