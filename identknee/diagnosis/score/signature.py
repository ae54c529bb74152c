"""What an effect would add to the residuals, and how strongly residuals speak for it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product

import numpy as np

from identknee.diagnosis.score.misfit import Projector, log_weighted_tail, z_score_of_log_tail
from identknee.runs.arrays import Array, IntArray, frozen_integers
from identknee.runs.declare import array, declared, entry

# Signs are dealt with by trying every set of amplitudes that are not zero.
MOST_SIGNED = 6
# A signature of which less is left is explained by the fitted parameters.
LEAST_LEFT = 1e-6
# The share of draws with each set of signed amplitudes; mirrored pairs make one sign exactly 1/2.
SIGN_DRAWS, SIGN_SEED = 4000, 0
# Roots of the statistic, over that of its largest weight, at which its tail is tabulated.
ROOTS = np.concatenate([np.linspace(0.0, 10.0, 201), np.geomspace(10.2, 1e4, 150)])


@declared
class Signature:
    """The change of the whitened predictions that an effect would cause.

    Raises
    ------
    ValueError
        If shapes disagree, a prior is not positive, a sign is none or more than 6 are given.
    """

    name: str = entry("Name of the effect")
    variant: str = entry(
        "What distinguishes signatures of one effect, such as a site or a slack strain; may be "
        "empty"
    )
    columns: Array = array(
        "Change of the data for an amplitude of 1 of each parameter", "row", "amplitude"
    )
    prior_sd: Array = array("Prior standard deviation of each amplitude, > 0", "amplitude")
    sign: IntArray = array(
        "1 or -1 for an amplitude that can have that sign only, 0 for either",
        "amplitude",
        dtype=int,
    )

    def __post_init__(self) -> None:
        if not np.isin(self.sign, (-1, 0, 1)).all():
            raise ValueError(f"{self.name}: sign must be -1, 0 or 1 for each amplitude")
        if np.count_nonzero(self.sign) > MOST_SIGNED:
            raise ValueError(
                f"{self.name}: at most {MOST_SIGNED} amplitudes can have a sign; split the effect"
            )
        if not np.all((self.prior_sd > 0) & np.isfinite(self.prior_sd)):
            raise ValueError(f"{self.name}: every prior_sd must be greater than 0 and finite")

    @property
    def n_parameters(self) -> int:
        """Amplitudes of the effect."""
        return int(self.columns.shape[1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProjectedSignature:
    """A signature without what the fitted parameters explain of it, and its statistic.

    The statistic is the gain: how much the objective (sum of squares plus prior penalty) falls when
    the amplitudes are free, within their signs. It is a function of the correlations
    ``u = projected' r``.

    Attributes
    ----------
    signature
        As it was.
    projected
        Its projected columns, shape ``(m, k)``.
    gram
        Information about the amplitudes without their prior, shape ``(k, k)``.
    covariance
        Covariance of the amplitudes, prior included, signs left out of account, shape ``(k, k)``.
    """

    signature: Signature
    projected: Array
    gram: Array = field(init=False, repr=False)
    covariance: Array = field(init=False, repr=False)
    _solutions: list[tuple[IntArray, Array]] = field(init=False, repr=False)
    _roots: Array = field(init=False, repr=False)
    _z_scores: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "gram", self.projected.T @ self.projected)
        precision = self.gram + np.diag(self.signature.prior_sd**-2.0)
        object.__setattr__(self, "covariance", np.linalg.inv(precision))
        solutions = _solutions(precision, self.signature.sign) if self.is_seen else []
        object.__setattr__(self, "_solutions", solutions)
        roots, z_scores = self._tabulate() if self.is_seen else (np.zeros(1), np.zeros(1))
        object.__setattr__(self, "_roots", roots)
        object.__setattr__(self, "_z_scores", z_scores)

    @property
    def n_parameters(self) -> int:
        """Amplitudes of the effect."""
        return self.signature.n_parameters

    @property
    def share_left(self) -> float:
        """Length of what is left over the length of the signature, 0 where it has none."""
        size = float(np.linalg.norm(self.signature.columns))
        return float(np.linalg.norm(self.projected)) / size if size > 0 else 0.0

    @property
    def is_seen(self) -> bool:
        """Whether anything is left that the fitted parameters do not explain."""
        return self.share_left > LEAST_LEFT

    def gain(self, correlations: Array) -> Array:
        """The statistic of each draw, shape ``(n,)``, from its correlations, ``(n, k)``."""
        gain = np.zeros(len(correlations))
        for _, _, value in self._feasible(correlations):
            np.maximum(gain, value, out=gain)
        return gain

    def amplitude(self, correlations: Array) -> Array:
        """The most probable amplitudes of each draw, shape ``(n, k)``; zeros where none gains."""
        best = np.zeros(len(correlations))
        amplitude = np.zeros(correlations.shape)
        for used, found, value in self._feasible(correlations):
            better = value > best
            best[better] = value[better]
            amplitude[better] = 0.0
            amplitude[np.ix_(better, used)] = found[better]
        return amplitude

    def z_score(self, gain: Array) -> Array:
        """The z-score as rare under no effect as `gain`, 0 at least, any shape.

        With one amplitude of one sign it is the usual one-sided score. It is 0 for a signature that
        the fitted parameters explain.
        """
        return np.asarray(np.interp(np.sqrt(gain), self._roots, self._z_scores))

    def _feasible(self, correlations: Array) -> Iterator[tuple[IntArray, Array, Array]]:
        """Sets of free amplitudes, their values, and the gains: 0 where a sign is wrong."""
        for used, inverse in self._solutions:
            found = correlations[:, used] @ inverse
            value = np.einsum("nk,nk->n", found, correlations[:, used])
            wrong = (found * self.signature.sign[used] < 0).any(axis=1)
            yield used, found, np.where(wrong, 0.0, value)

    def _tabulate(self) -> tuple[Array, Array]:
        """Roots of the gain and the z-scores as rare."""
        weights = [
            np.maximum(np.linalg.eigvals(inverse @ self.gram[np.ix_(used, used)]).real, 0.0)
            for used, inverse in self._solutions
        ]
        largest = max(x.max() for x in weights)
        relative = tuple(tuple((x / largest).tolist()) for x in weights)
        return ROOTS * np.sqrt(largest), _z_scores_at_roots(tuple(self._shares()), relative)

    def _shares(self) -> list[float]:
        """How often each set of free amplitudes is the best one under no effect."""
        if not self.signature.sign.any():
            return [1.0]
        if self.n_parameters == 1:
            return [0.5]
        generator = np.random.default_rng(SIGN_SEED)
        half = generator.standard_normal((SIGN_DRAWS // 2, self.n_parameters))
        size, vectors = np.linalg.eigh(self.gram)
        draws = np.concatenate([half, -half]) @ (vectors * np.sqrt(np.maximum(size, 0.0))).T
        gains = np.array([value for _, _, value in self._feasible(draws)])
        best = gains.argmax(axis=0)[gains.max(axis=0) > 0]
        shares: list[float] = (np.bincount(best, minlength=len(gains)) / len(draws)).tolist()
        return shares


# Of all signatures with one amplitude it is one of two.
@lru_cache(maxsize=8)
def _z_scores_at_roots(shares: tuple[float, ...], weights: tuple[tuple[float, ...], ...]) -> Array:
    """The z-scores as rare as the roots: a mixture over the sets that may be free."""
    log_tails = [
        np.log(share) + log_weighted_tail(ROOTS**2, np.array(weight))
        for share, weight in zip(shares, weights, strict=True)
        if share > 0
    ]
    z_scores = z_score_of_log_tail(np.logaddexp.reduce(log_tails, axis=0))
    z_scores = np.maximum(np.maximum.accumulate(z_scores), 0.0)
    z_scores.flags.writeable = False
    return z_scores


def _solutions(precision: Array, sign: IntArray) -> list[tuple[IntArray, Array]]:
    """The sets of amplitudes that may be free, each with the inverse of its precision.

    The best point under signs is the free solution of one such set, so that the best feasible one
    among them is exact.
    """
    is_signed = sign != 0
    solutions: list[tuple[IntArray, Array]] = []
    for choice in product((True, False), repeat=int(is_signed.sum())):
        free = ~is_signed
        free[is_signed] = choice
        used = np.flatnonzero(free)
        if len(used):
            inverse = np.asarray(np.linalg.inv(precision[np.ix_(used, used)]), dtype=np.float64)
            solutions.append((frozen_integers(used), inverse))
    return solutions


def project_signature(projector: Projector, signature: Signature) -> ProjectedSignature:
    """The signature without what the fitted parameters explain, and its statistic."""
    return ProjectedSignature(signature=signature, projected=projector.project(signature.columns))


def effect_names(signatures: Sequence[ProjectedSignature]) -> tuple[str, ...]:
    """The effects whose variants these are, in the order first met."""
    return tuple(dict.fromkeys(x.signature.name for x in signatures))
