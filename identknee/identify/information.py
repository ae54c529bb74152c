"""The Fisher information at one point, with its spectrum and collinearity."""

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

import numpy as np

from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.problem import Problem, typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry

# In scaled units. The perturbation must be small against any curvature and large against the
# rounding of theta; the steps are tried from long to short.
PERTURBATION = 1e-8
N_PERTURBATIONS = 8
STEPS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


@declared
class JacobianNoise:
    """Errors of the derivatives of m residuals by n scaled parameters."""

    rounding: float = entry(
        "Largest singular value of the change of the Jacobian under perturbations of theta of "
        "1e-8, linear change taken out: what the solver's tolerance and rounding do",
        unit="1",
    )
    errors: Array = array(
        "Differences of the residuals less the Jacobian, by the step that agrees best: bounds what "
        "is wrong with the Jacobian for any reason; zero in columns in which no step had a "
        "prediction",
        *("residual", "parameter"),
    )
    steps: Array = array(
        "Step of each column, in scaled units; NaN where none had a prediction", "parameter"
    )

    def floors(self, directions: Array) -> Array:
        """Square of the error along each of the unit `directions`, columns (n, k); ``(k,)``.

        An eigenvalue of the information below its floor may as well be zero.
        """
        along = np.linalg.norm(self.errors @ directions, axis=0)
        return np.asarray(np.maximum(along, self.rounding) ** 2)


def jacobian_noise(
    evaluator: Evaluator, at: Evaluation, scales: Array, *, seed: int = 0
) -> JacobianNoise:
    """The errors of the Jacobian at a point.

    Parameters
    ----------
    evaluator
        Evaluations of the problem.
    at
        The point, within the bounds, with a prediction.
    scales
        One scaled unit of each parameter, shape ``(n,)``.
    seed
        Seed of the perturbations.

    Raises
    ------
    ValueError
        If the point lies outside the bounds.
    """
    parameters = evaluator.parameters
    outside = np.flatnonzero((at.theta < parameters.lower) | (at.theta > parameters.upper))
    if outside.size:
        i = int(outside[0])
        raise ValueError(
            f"{parameters.names[i]} is {at.theta[i]:g}, outside its bounds "
            f"{parameters.lower[i]:g} to {parameters.upper[i]:g}; give a theta inside them"
        )
    columns = [_column(evaluator, at, scales, i) for i in range(at.theta.size)]
    return JacobianNoise(
        rounding=_rounding(evaluator, at, scales, np.random.default_rng(seed)),
        errors=np.stack([error for error, _ in columns], axis=1),
        steps=np.array([step for _, step in columns]),
    )


def _rounding(
    evaluator: Evaluator, at: Evaluation, scales: Array, generator: np.random.Generator
) -> float:
    """Largest singular value of the noise of the Jacobian, over the perturbations."""
    sizes = [0.0]
    parameters = evaluator.parameters
    for _ in range(N_PERTURBATIONS):
        move = PERTURBATION * scales * generator.choice([-1.0, 1.0], at.theta.size)
        # Where a bound is in the way the middle of the three points moves inward.
        middle = np.clip(at.theta, parameters.lower + abs(move), parameters.upper - abs(move))
        three = [evaluator(middle + sign * move) for sign in (-1.0, 0.0, 1.0)]
        if all(x.is_finite for x in three):
            low, here, high = (x.jacobian * scales for x in three)
            # The variance of independent errors in such a sum is 1 + 4 + 1 times theirs.
            noise = (low - 2.0 * here + high) / np.sqrt(6.0)
            sizes.append(float(np.linalg.norm(noise, 2)))
    return max(sizes)


def _column(evaluator: Evaluator, at: Evaluation, scales: Array, i: int) -> tuple[Array, float]:
    """Difference less derivative by one parameter, and the step where they agree best."""
    exact = at.jacobian[:, i] * scales[i]
    best, best_step = np.zeros(exact.size), np.nan
    for step in STEPS:
        slope = _difference(evaluator, at, i, step * scales[i])
        if slope is None:
            continue
        error = slope * scales[i] - exact
        if np.isnan(best_step) or np.linalg.norm(error) < np.linalg.norm(best):
            best, best_step = error, step
    return best, best_step


def _difference(evaluator: Evaluator, at: Evaluation, i: int, step: float) -> Array | None:
    """Fourth-order central difference; second-order to the inside where a bound is near."""
    parameters, place = evaluator.parameters, at.theta[i]
    room_below, room_above = place - parameters.lower[i], parameters.upper[i] - place

    def residuals(steps: float) -> Array:
        theta = np.array(at.theta)
        theta[i] += steps * step
        found = evaluator(theta)
        return found.residuals if found.is_finite else np.full(at.residuals.size, np.nan)

    if min(room_below, room_above) >= 2.0 * step:
        near, far = residuals(1.0) - residuals(-1.0), residuals(2.0) - residuals(-2.0)
        slope = (8.0 * near - far) / (12.0 * step)
    elif max(room_below, room_above) >= 2.0 * step:
        side = 1.0 if room_above > room_below else -1.0
        there = 4.0 * residuals(side) - residuals(2.0 * side)
        slope = (there - 3.0 * at.residuals) / (2.0 * side * step)
    else:
        return None
    return slope if np.isfinite(slope).all() else None


Scaling = Literal["typical", "prior"]
# Pairs and triples worth saying.
MOST_COLLINEAR = 3
# A share of a parameter in a direction that is not worth naming.
NEGLIGIBLE_SHARE = 0.1
# A share below this, squared, is rounding: the parameter has no part in an undetermined direction.
ROUNDING = 1e-12


@declared
class Eigenvalue:
    """How well the data determine one combination of parameters."""

    value: float = entry("Eigenvalue of the information in scaled units", unit="1")
    floor: float = entry("Value below which it is the solver's noise", unit="1")
    above_noise: bool = entry("Whether it is larger than that")
    combination: str = entry("Shares of the parameters in the combination, the largest first")


@declared
class Collinear:
    """Parameters whose effects are nearly collinear."""

    parameters: tuple[str, ...] = entry("Names of the parameters")
    collinearity: float = entry("Collinearity index of the set", unit="1")


@declared
class Information:
    """The Fisher information of n parameters at one theta, in scaled units.

    A scaled unit of a parameter is its entry in `scales`: moving one unit along eigenvector i
    raises the deviance by ``eigenvalues[i]`` (to second order), so that the data know the
    combination to ``1 / sqrt(eigenvalues[i])`` units.
    """

    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    scaling: Scaling = entry(
        "Scaled unit: typical for a typical step (3 kN, 2 %, a prior's sd for other units), prior "
        "for the prior's standard deviation, in which an eigenvalue of 1 means that the data say "
        "as much as the prior"
    )
    theta: Array = array("Parameters at which it was computed", "parameter", unit=OF_PARAMETER)
    scales: Array = array(
        "One scaled unit of each parameter", "parameter", unit=OF_PARAMETER, key="scale"
    )
    jacobian: Array = array(
        "Derivatives of the residuals, in units of their noise, by the scaled parameters",
        *("residual", "parameter"),
    )
    eigenvalues: Array = array(
        "Eigenvalues in scaled units, from stiff to sloppy", "direction", key="eigenvalue"
    )
    eigenvectors: Array = array(
        "Eigenvectors as columns in the same order, the largest component of each positive",
        *("parameter", "direction"),
        key="eigenvector",
    )
    floors: Array = array(
        "Eigenvalue that the error of the derivatives alone would give in each direction",
        "direction",
        key="floor",
    )
    noise: JacobianNoise = entry("Errors of the derivatives")
    n_simulations: int = entry(
        "Simulations made, most of them for the noise",
        unit="1",
        is_in_json=False,
        is_in_arrays=True,
    )

    @property
    def matrix(self) -> Array:
        """The information in kN, % and the other units of theta, shape ``(n, n)``."""
        plain = self.jacobian / self.scales
        return np.asarray(plain.T @ plain)

    @property
    @derived(
        "Eigenvalues from stiff to sloppy, and the combinations they belong to", key="eigenvalues"
    )
    def spectrum(self) -> tuple[Eigenvalue, ...]:
        """Each eigenvalue with its floor and its combination of parameters."""
        return tuple(
            Eigenvalue(
                value=float(value),
                floor=float(floor),
                above_noise=bool(value > floor),
                combination=self.combination(i),
            )
            for i, (value, floor) in enumerate(zip(self.eigenvalues, self.floors, strict=True))
        )

    @property
    @derived("Number of eigenvalues above the noise", unit="1")
    def n_above_noise(self) -> int:
        """Number of eigenvalues above the errors of the derivatives."""
        return int(np.sum(self.eigenvalues > self.floors))

    @property
    @derived("Largest over smallest eigenvalue; null if the smallest is not above noise", unit="1")
    def condition(self) -> float:
        """Largest over smallest eigenvalue; infinite if the smallest is not above the noise."""
        if self.n_above_noise < len(self.eigenvalues):
            return np.inf
        return float(self.eigenvalues[0] / self.eigenvalues[-1])

    @property
    def sd(self) -> Array:
        """Standard deviation of each parameter by the linear model, in its own unit, ``(n,)``.

        Infinite where the parameter has a part in a direction that is not above the noise.
        """
        known, loose = self._spread()
        return np.where(np.diag(loose) > ROUNDING, np.inf, self.scales * np.sqrt(np.diag(known)))

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters by the linear model, shape ``(n, n)``.

        Where standard deviations are infinite it is the limit of those of a direction that gets
        ever less determined.
        """
        known, loose = self._spread()
        is_loose = np.diag(loose) > ROUNDING
        one_loose = is_loose[:, None] != is_loose
        covariance = np.where(is_loose[:, None] & is_loose, loose, np.where(one_loose, 0.0, known))
        sd = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(sd, sd))

    def combination(self, i: int) -> str:
        """Eigenvector i by the names of the parameters, in scaled units, largest share first.

        For example ``"+0.80 PCL.stiffness_kN -0.57 PCL.reference_strain_pct"``; shares below 0.1
        are left out.
        """
        return combination(self.parameter_names, self.eigenvectors[:, i])

    def collinearity(self, names: Sequence[str] | None = None) -> float:
        """Collinearity index of the parameters named.

        One over the least length of a unit combination of their columns, each of length 1: 1 for
        columns at right angles, infinite for dependent ones. From 10 to 15 on, changes of one
        parameter can be made up for by the others to within 10 to 7 % (all parameters if None).

        References
        ----------
        R. Brun, P. Reichert and H. R. Kuensch, Practical identifiability analysis of large
        environmental simulation models, Water Resour. Res. 37 (2001) 1015-1030, equation 10,
        doi:10.1029/2000WR900350.
        """
        chosen = [self.parameter_names.index(x) for x in names or self.parameter_names]
        return _collinearity(self.jacobian[:, chosen])

    def collinear_sets(self, size: int) -> tuple[Collinear, ...]:
        """All sets of `size` parameters with their collinearity, from large to small.

        Raises
        ------
        ValueError
            If the size is not between 2 and the number of parameters.
        """
        n = len(self.parameter_names)
        if not 2 <= size <= n:
            raise ValueError(f"a set must hold 2 to {n} parameters, got {size}")
        sets = [
            Collinear(
                parameters=tuple(self.parameter_names[i] for i in chosen),
                collinearity=_collinearity(self.jacobian[:, chosen]),
            )
            for chosen in map(list, combinations(range(n), size))
        ]
        return tuple(sorted(sets, key=lambda x: -x.collinearity))

    @property
    @derived("Collinearity index of all parameters", unit="1", key="collinearity")
    def collinearity_of_all(self) -> float:
        """Collinearity index of all parameters."""
        return self.collinearity()

    @property
    @derived("Pairs and triples that stand in for one another best", key="collinear")
    def most_collinear(self) -> tuple[Collinear, ...]:
        """The three most collinear pairs, then the three most collinear triples."""
        sizes = [x for x in (2, 3) if x <= len(self.parameter_names)]
        return tuple(x for size in sizes for x in self.collinear_sets(size)[:MOST_COLLINEAR])

    @property
    @derived("Parameters at which it was computed, by name", unit=OF_PARAMETER, key="theta")
    def theta_by_name(self) -> dict[str, float]:
        """Theta by parameter."""
        return dict(zip(self.parameter_names, self.theta.tolist(), strict=True))

    @property
    @derived("Scaled unit of each parameter", unit=OF_PARAMETER, key="scales")
    def scale_by_name(self) -> dict[str, float]:
        """Scaled unit by parameter."""
        return dict(zip(self.parameter_names, self.scales.tolist(), strict=True))

    @property
    @derived(
        "Standard deviation of each parameter if the model were linear; null where the data do "
        "not determine it",
        unit=OF_PARAMETER,
        key="sd",
    )
    def sd_by_name(self) -> dict[str, float]:
        """Standard deviation by parameter."""
        return dict(zip(self.parameter_names, self.sd.tolist(), strict=True))

    def _spread(self) -> tuple[Array, Array]:
        """Scaled covariance within the directions above the noise, projector on the others."""
        is_known = self.eigenvalues > self.floors
        known, loose = self.eigenvectors[:, is_known], self.eigenvectors[:, ~is_known]
        return known / self.eigenvalues[is_known] @ known.T, loose @ loose.T


def information(
    problem: Problem, theta: Array, *, scaling: Scaling = "typical", seed: int = 0
) -> Information:
    """The Fisher information of the parameters at `theta`, with the errors of the derivatives.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise. `WithPriors` of it gives the
        information of data and priors together.
    theta
        Where, within the bounds, shape ``(n,)``; usually the best fit.
    scaling
        What to count parameters in, which eigenvalues and eigenvectors depend on: ``"typical"``
        steps or ``"prior"`` standard deviations.
    seed
        Seed of the perturbations that show the solver's noise.

    Raises
    ------
    ValueError
        If the model has no prediction at `theta`, or `theta` lies outside the bounds.

    References
    ----------
    J. J. Waterfall et al., Sloppy-model universality class and the Vandermonde matrix, Phys. Rev.
    Lett. 97 (2006) 150601, doi:10.1103/PhysRevLett.97.150601.
    """
    parameters, evaluator = problem.parameters, Evaluator(problem)
    scales = scaled_units(parameters, scaling)
    evaluation = evaluator(np.asarray(theta, dtype=np.float64))
    if not evaluation.is_finite:
        raise ValueError(
            "the model has no prediction at this theta, so nothing is known of its derivatives; "
            "give another theta, for example the best fit"
        )
    noise = jacobian_noise(evaluator, evaluation, scales, seed=seed)
    jacobian = evaluation.jacobian * scales
    eigenvalues, eigenvectors = spectrum(jacobian)
    # What rounding alone does to the singular values.
    rounding = max(jacobian.shape) * np.finfo(np.float64).eps * np.linalg.norm(jacobian, 2)
    return Information(
        parameter_names=parameters.names,
        theta=evaluation.theta,
        scaling=scaling,
        scales=scales,
        jacobian=jacobian,
        eigenvalues=eigenvalues,
        eigenvectors=eigenvectors,
        floors=np.maximum(noise.floors(eigenvectors), rounding**2),
        noise=noise,
        n_simulations=evaluator.n_simulations,
    )


def scaled_units(parameters: Parameters, scaling: Scaling) -> Array:
    """One scaled unit of each parameter, shape ``(n,)``.

    Raises
    ------
    ValueError
        If there is no such scaling.
    """
    if scaling == "typical":
        return typical_steps(parameters)
    if scaling == "prior":
        return parameters.prior_sd_in_own_units
    raise ValueError(f"there is no scaling {scaling!r}; the scalings are typical, prior")


def spectrum(jacobian: Array) -> tuple[Array, Array]:
    """Eigenvalues of ``jacobian.T @ jacobian`` from large to small, eigenvectors as columns.

    From the singular values, so that small eigenvalues keep their digits; the largest component of
    an eigenvector is positive.

    Examples
    --------
    >>> spectrum(np.diag([1.0, 3.0]))[0].tolist()
    [9.0, 1.0]
    """
    n = jacobian.shape[1]
    _, sizes, rows = np.linalg.svd(np.vstack([jacobian, np.zeros((n, n))]), full_matrices=False)
    vectors = rows.T
    largest = vectors[np.argmax(np.abs(vectors), axis=0), np.arange(n)]
    return sizes**2, vectors * np.sign(largest)


def combination(names: Sequence[str], direction: Array) -> str:
    """A direction of length 1 in scaled units by the names of the parameters.

    Shares below 0.1 are left out, the largest comes first.
    """
    order = np.argsort(-np.abs(direction), kind="stable")
    return " ".join(
        f"{direction[i]:+.2f} {names[i]}" for i in order if abs(direction[i]) >= NEGLIGIBLE_SHARE
    )


def _collinearity(columns: Array) -> float:
    lengths = np.linalg.norm(columns, axis=0)
    if not lengths.all():
        return np.inf
    least = np.linalg.svd(columns / lengths, compute_uv=False)[-1]
    if len(columns) < columns.shape[1] or least <= np.finfo(np.float64).eps:
        return np.inf
    return float(1.0 / least)
