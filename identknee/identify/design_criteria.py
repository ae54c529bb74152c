"""Design criteria: losses that are functions of a sum over the added trials.

Every trial has features, numbers that add up over the trials of a set; a loss is a function of the
sum. A set is then judged without another simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np
from typing_extensions import override

from identknee.calibrate.problem import Problem, ProblemAround, Quantity, evaluate
from identknee.identify.information import scaled_units
from identknee.identify.profile.result import Profile
from identknee.runs.declare import Array, BoolArray, IntArray, declared, derived, entry
from identknee.runs.executors import Executor
from identknee.runs.marginalise import schur_complement

Criterion = Literal["D", "A", "E", "c", "width"]
CRITERIA: tuple[Criterion, ...] = ("D", "A", "E", "c", "width")
# A direction that nothing determines counts as known to 1,000 scaled units.
LEAST_INFORMATION = 1e-6
# Least rise of the root of the deviance: one flatter would be extrapolated without limit.
LEAST_RISE = 1e-6
# Share of that root: how far below the threshold a profile may end that was followed to it.
END_TOLERANCE = 1e-3


class Loss(Protocol):
    """A design criterion to be minimised."""

    def features_of_data(self, information: Array) -> Array:
        """Features of the trials made, shape ``(f,)``, from their scaled information at the points.

        The information has shape ``(q, n, n)``.
        """

    def features_of_trials(self, values: Array, jacobians: Array) -> Array:
        """Features of k trials, shape ``(k, f)``.

        From their predictions at q points in units of the noise, shape ``(q, k, m)``, and the
        derivatives of these by the scaled parameters, ``(q, k, m, n)``.
        """

    def __call__(self, features: Array) -> Array:
        """The loss of each row of summed features, shape ``(k,)`` from ``(k, f)``."""


@declared
class LocalLoss:
    """D-, A-, E- or c-optimality of the information at the first point, the best fit.

    What is asked is the covariance of the parameters of interest, nuisances integrated out.

    References
    ----------
    A. C. Atkinson, A. N. Donev and R. D. Tobias, Optimum Experimental Designs, with SAS (2007),
    chapter 10, ISBN 978-0-19-929660-6.
    """

    criterion: Criterion = entry(
        '``"D"``: minus the log determinant; ``"A"``: the trace of the covariance; '
        '``"E"``: its largest eigenvalue; ``"c"``: the log variances of the targets, summed'
    )
    gradients: Array = entry(
        "Gradients of the targets by the scaled parameters at the best fit, shape ``(t, n)``"
    )
    is_of_interest: BoolArray = entry("Which parameters are no nuisances, shape ``(n,)``")

    def features_of_data(self, information: Array) -> Array:
        """The scaled information at the best fit, shape ``(n n,)``."""
        return np.asarray(information[0].ravel())

    def features_of_trials(self, values: Array, jacobians: Array) -> Array:
        """Scaled information of each trial at the best fit, shape ``(k, n n)``."""
        at_fit = jacobians[0]
        return np.asarray(np.einsum("kmi,kmj->kij", at_fit, at_fit).reshape(values.shape[1], -1))

    def __call__(self, features: Array) -> Array:
        """The loss of each information, shape ``(k,)``."""
        if self.criterion == "c":
            return np.asarray(np.log(self.variances(features)).sum(axis=1))
        # Inverses of the covariances of the parameters of interest.
        matrices = schur_complement(self._matrices(features), self.is_of_interest)
        eigenvalues = np.linalg.eigvalsh(matrices)
        if self.criterion == "D":
            return np.asarray(-np.log(eigenvalues).sum(axis=1))
        if self.criterion == "A":
            return np.asarray((1.0 / eigenvalues).sum(axis=1))
        return np.asarray(1.0 / eigenvalues[:, 0])

    def variances(self, features: Array) -> Array:
        """Variance of each target by the linear model, shape ``(k, t)``."""
        inverse = np.linalg.inv(self._matrices(features))
        return np.asarray(np.einsum("ti,kij,tj->kt", self.gradients, inverse, self.gradients))

    def _matrices(self, features: Array) -> Array:
        n = self.gradients.shape[1]
        return np.asarray(features.reshape(-1, n, n) + LEAST_INFORMATION * np.eye(n))


@declared
class Path:
    """The profile of one target before trials are added."""

    places: IntArray = entry(
        "Where its s points stand among the points at which trials are predicted, shape ``(s,)``"
    )
    values: Array = entry("The target there, from low to high, shape ``(s,)``")
    deltas: Array = entry("Rise of the deviance there, shape ``(s,)``")
    across: Array = entry(
        "Orthonormal directions of the scaled parameters that leave the target as it is, ``(s, "
        "n, n - 1)``"
    )
    center: float = entry("The target at the best fit")
    threshold: float = entry("Rise of the deviance that bounds the interval")

    def ends(self, deltas: Array) -> tuple[Array, BoolArray]:
        """Interval ends for k profiles on the same points, shape ``(k, 2)``, and which are open.

        Between points the root of the deviance is linear. An open end is put where the root would
        reach the threshold if it went on in proportion.
        """
        ends, is_open = np.empty((len(deltas), 2)), np.zeros((len(deltas), 2), bool)
        for side, sign in enumerate((-1.0, 1.0)):
            chosen = np.flatnonzero(sign * (self.values - self.center) > 0)[:: int(sign)]
            away = np.concatenate([[0.0], np.abs(self.values[chosen] - self.center)])
            roots = np.sqrt(np.maximum(deltas[:, chosen], 0.0))
            roots = np.hstack([np.zeros((len(deltas), 1)), roots])
            # How far out each row of roots first reaches the level, and which rows do not.
            level = float(np.sqrt(self.threshold))
            above = roots >= (1.0 - END_TOLERANCE) * level
            goes_on = ~above.any(axis=1)
            after = np.where(goes_on, len(away) - 1, np.argmax(above, axis=1))
            rows, before = np.arange(len(roots)), np.maximum(after - 1, 0)
            rise = roots[rows, after] - roots[rows, before]
            share = (level - roots[rows, before]) / np.where(rise > 0, rise, 1.0)
            between = away[before] + share * (away[after] - away[before])
            beyond = away[-1] * level / np.maximum(roots[:, -1], LEAST_RISE)
            is_open[:, side] = goes_on
            ends[:, side] = self.center + sign * np.where(goes_on, beyond, between)
        return ends, is_open


@declared
class WidthLoss:
    """Predicted widths of the targets' profiles, the sum of their logarithms.

    To every point of a target's profile the deviance of the added trials is added, as measured at
    the best fit, and the free parameters are refitted by one linear step. Thus an open end may
    close, which variances at the best fit cannot show.
    """

    paths: Sequence[Path] = entry("The profiles of the targets")

    def features_of_data(self, information: Array) -> Array:
        """Each point's curvature across the target, no slope, and the rise of the deviance."""
        parts = []
        for path in self.paths:
            at = information[path.places]
            curved = np.einsum("sia,sij,sjb->sab", path.across, at, path.across)
            parts += [curved.ravel(), np.zeros(path.across[:, 0].size), path.deltas]
        return np.concatenate(parts)

    def features_of_trials(self, values: Array, jacobians: Array) -> Array:
        """Each point's curvature and slope across the target and the rise, for each trial."""
        k, parts = values.shape[1], []
        for path in self.paths:
            away = values[path.places] - values[0]
            across = np.einsum("skmi,sia->skma", jacobians[path.places], path.across)
            # Beyond what the data allow a trial may have no prediction: it then says nothing.
            known = np.isfinite(away).all(axis=2) & np.isfinite(across).all(axis=(2, 3))
            away = np.where(known[:, :, None], away, 0.0)
            across = np.where(known[:, :, None, None], across, 0.0)
            curved = np.einsum("skma,skmb->ksab", across, across)
            slope = np.einsum("skma,skm->ksa", across, away)
            rise = np.einsum("skm,skm->ks", away, away)
            parts += [curved.reshape(k, -1), slope.reshape(k, -1), rise]
        return np.hstack(parts)

    def __call__(self, features: Array) -> Array:
        """The sum of the log widths, shape ``(k,)``."""
        total = np.zeros(len(features))
        for ends, _ in self.intervals(features):
            total += np.log(np.maximum(ends[:, 1] - ends[:, 0], np.finfo(np.float64).tiny))
        return total

    def intervals(self, features: Array) -> list[tuple[Array, BoolArray]]:
        """Each target's predicted ends, ``(k, 2)``, and which of them are open."""
        intervals, k, at = [], len(features), 0
        for path in self.paths:
            s, _, a = path.across.shape
            sizes = np.cumsum([at, s * a * a, s * a, s])
            curved, slope, rise = (features[:, i:j] for i, j in pairwise(sizes))
            at = int(sizes[-1])
            matrices = curved.reshape(k, s, a, a) + LEAST_INFORMATION * np.eye(a)
            column = slope.reshape(k, s, a, 1)
            saved = (column * np.linalg.solve(matrices, column)).sum(axis=(2, 3))
            intervals.append(path.ends(rise - saved))
        return intervals


def directions_across(gradients: Array) -> Array:
    """Orthonormal directions orthogonal to each gradient (s, n), shape ``(s, n, n - 1)``."""
    _, _, rows = np.linalg.svd(gradients[:, None, :], full_matrices=True)
    return np.asarray(np.swapaxes(rows[:, 1:], 1, 2))


class CandidateTrials(Protocol):
    """Trials that might be added, as a model predicts them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the k trials, no two alike."""

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """What the chosen trials would measure at `theta`, and its derivatives by theta.

        In units of the noise, errors independent, shapes ``(k, m)`` and ``(k, m, n)``; NaN in all
        of a trial that has no prediction. A trial may be chosen more than once.
        """


@declared
class Step:
    """A step beside one more trial: a cut and a trial in that state, or a force in a trial."""

    name: str = entry("Name of the step")
    kind: Literal["cut", "force", "contact"] = entry(
        "``cut``: a structure is cut and a trial made in that state; ``force``: the tension of a "
        "structure is measured in a trial; ``contact``: the forces of both compartments are"
    )
    structure: str = entry("The structure; empty for contact forces")
    trial: str = entry("Name of the trial")


@declared
class OfferedTrials:
    """Trials to choose from, and steps of other kinds to compare one more trial with."""

    trials: CandidateTrials = entry("The trials")
    steps: tuple[Step, ...] = entry("The other steps", default=())
    measured: CandidateTrials | None = entry(
        "What would be measured in the other steps, in their order", default=None
    )
    costs: Mapping[str, float] = entry(
        "What a step of each kind costs: ``trial``, ``error``, ``cut``, ``force``, ``contact``; 1 "
        "where nothing is said",
        default_factory=dict,
    )

    @property
    def all(self) -> CandidateTrials:
        """The trials, then the other steps."""
        if self.measured is None:
            return self.trials
        return SeveralCandidates(parts=(self.trials, self.measured))


@declared
class SeveralCandidates:
    """Candidates of several kinds as one list; those with fewer values have zeros for the rest."""

    parts: tuple[CandidateTrials, ...] = entry("The candidates of each kind")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all."""
        return tuple(name for part in self.parts for name in part.names)

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """As each kind predicts its own."""
        asked = np.asarray(chosen, int)
        sizes = np.cumsum([0, *(len(x.names) for x in self.parts)])
        of = np.searchsorted(sizes, asked, side="right") - 1
        found = []
        for i, part in enumerate(self.parts):
            rows = np.flatnonzero(of == i)
            if rows.size:
                found.append((rows, part.predict(theta, (asked[rows] - sizes[i]).tolist())))
        most = max(values.shape[1] for _, (values, _) in found)
        whole = np.zeros((len(of), most)), np.zeros((len(of), most, found[0][1][1].shape[2]))
        for rows, own in found:
            for into, values in zip(whole, own, strict=True):
                into[rows, : values.shape[1]] = values
        return whole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WithTrials(ProblemAround):
    """A problem with the residuals of added trials.

    Attributes
    ----------
    problem
        The problem without them.
    candidates
        The candidates that trials are added from.
    chosen
        Which of them were added.
    measured
        What they measured, in units of their noise, shape ``(k, m)``.
    """

    candidates: CandidateTrials
    chosen: tuple[int, ...]
    measured: Array
    _last: dict[bytes, Array] = field(init=False, repr=False, default_factory=dict)

    @override
    def residuals(self, theta: Array) -> Array:
        """Those of the problem, then those of the added trials; all infinite if any is."""
        made = self.problem.residuals(theta)
        values, jacobians = self.candidates.predict(theta, self.chosen)
        added = (values - self.measured).ravel()
        if not (np.isfinite(added).all() and np.isfinite(made).all()):
            return np.full(made.size + added.size, np.inf)
        self._last.clear()
        self._last[theta.tobytes()] = jacobians.reshape(added.size, -1)
        return np.concatenate([made, added])

    @override
    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals by theta, shape ``(m, n)``."""
        added = self._last.get(theta.tobytes())
        if added is None:
            _, jacobians = self.candidates.predict(theta, self.chosen)
            added = jacobians.reshape(self.measured.size, -1)
        return np.vstack([self.problem.jacobian(theta), added])


@declared
class Excluded:
    """An excluded candidate, and the reason."""

    name: str = entry("Name of the trial", key="trial")
    failures: int = entry(
        "Parameter sets that the data allow at which it has no prediction", unit="1"
    )
    tried: int = entry("Parameter sets at which it was predicted", unit="1")
    at_fit: bool = entry("Whether it has no prediction at the best fit")

    @property
    @derived("Why it is not offered", key="reason")
    def sentence(self) -> str:
        if self.at_fit:
            return f"{self.name} has no prediction at the best fit."
        return (
            f"{self.name} has no prediction at {self.failures} of {self.tried} parameter sets that "
            "the data allow."
        )


@declared
class CandidatePredictions:
    """The candidates at the best fit and along the profiles: q points, k trials, n parameters."""

    thetas: Array = entry("The points, the first of them the best fit, shape ``(q, n)``")
    is_likely: BoolArray = entry("Which of them the data allow, shape ``(q,)``")
    values: Array = entry(
        "What the trials would measure, in units of the noise, shape ``(q, k, m)``; NaN where "
        "there is no prediction"
    )
    jacobians: Array = entry(
        "Derivatives of that by the scaled parameters, shape ``(q, k, m, n)``; NaN where those are"
    )
    information: Array = entry(
        "That of the trials made, for the scaled parameters, shape ``(q, n, n)``"
    )
    scales: Array = entry("One scaled unit of each parameter, shape ``(n,)``")

    @property
    def n_simulations(self) -> int:
        """Two at each point: the trials made, and the candidates."""
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
        offered = loss.features_of_trials(self.values[:, allowed], self.jacobians[:, allowed])
        trials = np.zeros((len(allowed), offered.shape[1]))
        trials[allowed] = offered
        return loss.features_of_data(self.information), trials


def predict_candidates(
    problem: Problem, before: Sequence[Profile], candidates: CandidateTrials, executor: Executor
) -> CandidatePredictions:
    """The candidates predicted at the best fit and along the profiles."""
    scales = scaled_units(problem.parameters, "typical")
    thetas = np.vstack([before[0].optimum, *(profile.thetas for profile in before)])
    likely = [profile.deltas <= profile.threshold for profile in before]
    rows = list(executor.map(partial(_at_point, problem, candidates), thetas))
    return CandidatePredictions(
        thetas=thetas,
        is_likely=np.concatenate([[True], *likely]),
        values=np.array([x[1] for x in rows]),
        jacobians=np.array([x[2] for x in rows]) * scales,
        information=np.array([x[0] for x in rows]) * np.outer(scales, scales),
        scales=scales,
    )


def _at_point(
    problem: Problem, candidates: CandidateTrials, theta: Array
) -> tuple[Array, Array, Array]:
    """Information of the trials made and predictions of all candidates at one theta."""
    predicted = candidates.predict(theta, range(len(candidates.names)))
    return (evaluate(problem, theta).information, *predicted)


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
