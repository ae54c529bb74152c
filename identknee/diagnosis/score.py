"""Scores of every candidate cause on one scale, and which amplitudes they would show."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import unique
from functools import lru_cache
from itertools import product
from typing import Literal

import numpy as np

from identknee.diagnosis.misfit import (
    Projector,
    log_tail_of_z_score,
    log_weighted_tail,
    z_score_of_log_tail,
)
from identknee.runs.declare import Array, IntArray, array, declared, entry, frozen, frozen_integers
from identknee.runs.record import WithSentence

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
        # Roots of the gain, and the z-scores as rare.
        roots, z_scores = np.zeros(1), np.zeros(1)
        if self.is_seen:
            weights = [
                np.maximum(np.linalg.eigvals(inverse @ self.gram[np.ix_(used, used)]).real, 0.0)
                for used, inverse in solutions
            ]
            largest = max(x.max() for x in weights)
            relative = tuple(tuple((x / largest).tolist()) for x in weights)
            roots = ROOTS * np.sqrt(largest)
            z_scores = _z_scores_at_roots(tuple(self._shares()), relative)
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
        """Whether the signature is not fully explained by the fitted parameters."""
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


Scale = Literal["known", "unknown"]
N_DRAWS = 4000
# Numbers drawn at once, so that the draws for many values need little memory.
AT_ONCE = 4_000_000
# The probability of a false alarm at which the quantile is taken.
LEVEL = 0.05
# Effects closer than this cannot be distinguished; it allows for overestimated amplitudes.
LEAST_DISTANCE = 5.0
# A z-score below it is the root of a rounding error, and would order causes by the processor.
ROUNDED_SCORE = 1e-6
# Residuals smaller than this share of the noise are what a search or rounding left, no measurement.
ROUNDED_RESIDUAL = 1e-4
# An effect that would be found this often counts as one the data can exclude.
HIGH_POWER = 0.75
# Share of data sets in which a detectable amplitude is found.
DETECTED = 0.9
POWER_DRAWS, POWER_SEED = 1000, 0
# Prior standard deviations within which a detectable amplitude is looked for, and its precision.
SMALLEST, LARGEST, PRECISION = 1e-4, 1e4, 1e-3


@declared
class CandidateScore:
    """Score of one candidate cause."""

    name: str = entry("Name of the effect")
    variant: str = entry("Its variant that scores highest")
    score: float = entry("Z-score as rare under no effect, all variants tried counted; 0 at least")
    p_value: float = entry(
        "Probability that the largest score of all candidates is this large under no effect"
    )
    amplitude: Array = entry(
        "Expected amplitudes of that variant, most probable under prior and signs, shape ``(k,)``"
    )
    covariance: Array = entry("Covariance of the amplitudes, shape ``(k, k)``")
    gain: float = entry("Expected fall of the objective when the effect joins the model")
    share_left: float = entry(
        "Share of the signature that the fitted parameters do not explain, as a length"
    )


@declared
class Scores:
    """Scores of all candidates, the highest first."""

    candidates: tuple[CandidateScore, ...] = entry("One for each effect")
    quantile: float = entry("What the highest score exceeds with 5 % probability under no effect")

    @property
    def max_score(self) -> float:
        """The highest score."""
        return self.candidates[0].score

    @property
    def p_value(self) -> float:
        """Probability of a maximum as high under no effect."""
        return self.candidates[0].p_value


@declared
class ScoreTest:
    """The max-score test of a library of effects against one fit, made by `score_test`."""

    projector: Projector = entry("Projector of the fit")
    signatures: tuple[ProjectedSignature, ...] = entry("All variants of all effects, projected")
    scale: Scale = entry(
        '``"known"`` noise, or ``"unknown"``: residuals count in units of their own size, '
        "which is exact for any common standard deviation of the data"
    )
    trials_factors: Array = entry(
        "How many independent variants those of each effect are worth, in the order of `names`"
    )
    null: Array = entry("Largest scores under no effect, increasing, shape ``(n_draws,)``")
    seed: int = entry("Seed of the draws")

    @property
    def names(self) -> tuple[str, ...]:
        """The effects, in the order first given."""
        return effect_names(self.signatures)

    @property
    def quantile(self) -> float:
        """What the largest score exceeds with 5 % probability under no effect."""
        return float(np.quantile(self.null, 1 - LEVEL, method="higher"))

    def p_value(self, score: float) -> float:
        """Probability that the largest score is as large under no effect."""
        below = int(np.searchsorted(self.null, score, side="left"))
        return (len(self.null) - below + 1) / (len(self.null) + 1)

    def signature(self, name: str, variant: str) -> ProjectedSignature:
        """That variant of that effect, projected."""
        return next(
            x
            for x in self.signatures
            if x.signature.name == name and x.signature.variant == variant
        )

    def max_scores(self, residuals: Array) -> Array:
        """The largest score of each of n residual vectors, shape ``(n,)`` from ``(n, m)``."""
        z_scores = _z_scores(_in_units(residuals, self.projector, self.scale), self.signatures)
        scores = _by_name(z_scores, self.signatures)
        return np.asarray(_corrected(scores, self.trials_factors).max(axis=1))

    def evaluate(self, residuals: Array) -> Scores:
        """The scores of all candidates.

        Parameters
        ----------
        residuals
            Whitened, measured less predicted, followed by the rows of the prior where the projector
            has them (mean less fitted value, in units of the prior's spread), shape ``(m,)``.
        """
        counted = _in_units(residuals[None], self.projector, self.scale)
        z_scores = _z_scores(counted, self.signatures)
        scores = _corrected(_by_name(z_scores, self.signatures), self.trials_factors)[0]
        found, names = [], self.names
        for i in np.argsort(-scores, kind="stable"):
            own = [k for k, x in enumerate(self.signatures) if x.signature.name == names[i]]
            best = self.signatures[max(own, key=lambda k: z_scores[0, k])]
            correlations = self.projector.project(residuals)[None] @ best.projected
            found.append(
                CandidateScore(
                    name=names[i],
                    variant=best.signature.variant,
                    score=float(scores[i]),
                    p_value=self.p_value(float(scores[i])),
                    amplitude=frozen(best.amplitude(correlations)[0], None, name="amplitude"),
                    covariance=frozen(best.covariance, None, None, name="covariance"),
                    gain=float(best.gain(correlations)[0]),
                    share_left=best.share_left,
                )
            )
        return Scores(candidates=tuple(found), quantile=self.quantile)


def score_test(
    projector: Projector,
    signatures: Sequence[Signature],
    *,
    seed: int,
    scale: Scale = "known",
    n_draws: int = N_DRAWS,
) -> ScoreTest:
    """The max-score test, with the distribution of its maximum under no effect by simulation.

    Every effect scores with the variant that fits best, as a z-score as rare under no
    effect: its gain, penalised by the prior of its amplitudes, is turned into a probability that
    knows their number and signs, and that is multiplied by the number of independent looks its
    variants are worth (Gross and Vitells). So effects with one and with many amplitudes or variants
    compare. Residuals of pure noise go through the same code.

    Parameters
    ----------
    projector
        Projector of the fit.
    signatures
        All variants of all effects; variants of one effect share its name.
    seed
        Seed of the draws.
    scale
        ``"unknown"`` where the size of the noise is not known.
    n_draws
        Draws of noise.

    Raises
    ------
    ValueError
        If there are no signatures.

    References
    ----------
    E. Gross and O. Vitells, Trial factors for the look elsewhere effect in high energy physics,
    Eur. Phys. J. C 70 (2010) 525-530, doi:10.1140/epjc/s10052-010-1470-8.
    """
    if not signatures:
        raise ValueError("the score test needs at least one signature")
    projected = tuple(project_signature(projector, x) for x in signatures)
    generator, at_once = np.random.default_rng(seed), max(1, AT_ONCE // projector.n_rows)
    z_scores = []
    for first in range(0, n_draws, at_once):
        draws = generator.standard_normal((min(at_once, n_draws - first), projector.n_rows))
        z_scores.append(_z_scores(_in_units(draws, projector, scale), projected))
    scores = _by_name(np.concatenate(z_scores), projected)
    # By how much more often than one z-score the largest of each effect exceeds its quantile.
    names = [x.signature.name for x in projected]
    variants = np.array([names.count(x) for x in effect_names(projected)], dtype=np.float64)
    quantiles = np.quantile(scores, 1 - LEVEL, axis=0)
    factors = np.clip(LEVEL / np.exp(log_tail_of_z_score(quantiles)), 1.0, variants)
    return ScoreTest(
        projector=projector,
        signatures=projected,
        scale=scale,
        trials_factors=frozen(factors, None, name="trials_factors"),
        null=frozen(np.sort(_corrected(scores, factors).max(axis=1)), None, name="null"),
        seed=seed,
    )


def _in_units(residuals: Array, projector: Projector, scale: Scale) -> Array:
    """Projected residuals in units of their noise, shape ``(n, m)``."""
    projected = projector.project(residuals.T).T
    if scale == "known":
        return projected
    root = np.sqrt(projector.degrees_of_freedom)
    size = np.linalg.norm(projected, axis=1, keepdims=True)
    return np.asarray(projected * root / np.maximum(size, ROUNDED_RESIDUAL * root))


def _z_scores(residuals: Array, signatures: Sequence[ProjectedSignature]) -> Array:
    """The z-score of each signature for each of n projected residuals, shape ``(n, s)``."""
    correlations = residuals @ np.hstack([x.projected for x in signatures])
    ends = np.cumsum([x.n_parameters for x in signatures])
    return np.stack(
        [
            x.z_score(x.gain(correlations[:, end - x.n_parameters : end]))
            for x, end in zip(signatures, ends, strict=True)
        ],
        axis=1,
    )


def _by_name(z_scores: Array, signatures: Sequence[ProjectedSignature]) -> Array:
    """The largest z-score of each effect, shape ``(n, e)``."""
    names = np.array([x.signature.name for x in signatures])
    return np.stack([z_scores[:, names == x].max(axis=1) for x in effect_names(signatures)], axis=1)


def _corrected(scores: Array, trials_factors: Array) -> Array:
    """Z-scores as rare as the largest of so many independent ones, 0 at least."""
    corrected = z_score_of_log_tail(log_tail_of_z_score(scores) + np.log(trials_factors))
    return np.where(corrected < ROUNDED_SCORE, 0.0, corrected)


@unique
class Cell(WithSentence):
    """What a score test says of one effect: significant or not, crossed with its power.

    References
    ----------
    W. E. Saris, A. Satorra and W. M. van der Veld, Testing structural equation models or detection
    of misspecifications?, Struct. Equ. Modeling 16 (2009) 561-582, doi:10.1080/10705510903203433.
    """

    MISSPECIFIED = (
        "misspecified",
        "The effect is detected although the power for a relevant size is low.",
    )
    INSPECT = ("inspect", "The effect is detected, as small ones would be: its amplitude decides.")
    EXCLUDED = ("excluded", "The effect is not detected, and a relevant size would have been.")
    INCONCLUSIVE = (
        "inconclusive",
        "The effect is not detected, but a relevant size could have been missed.",
    )


def classify_effect(*, is_significant: bool, power: float) -> Cell:
    """Classification of an effect by its score and the power for a relevant size."""
    is_powerful = power >= HIGH_POWER
    if is_significant:
        return Cell.INSPECT if is_powerful else Cell.MISSPECIFIED
    return Cell.EXCLUDED if is_powerful else Cell.INCONCLUSIVE


def detection_power(test: ScoreTest, signature: ProjectedSignature, amplitude: Array) -> float:
    """Power of the test for the effect, by simulation."""
    draws = _noise(signature)
    return _detected_fraction(
        signature, draws + signature.gram @ amplitude, _threshold(test, signature)
    )


def detectable_amplitude(test: ScoreTest, signature: ProjectedSignature, parameter: int) -> float:
    """Size of a single amplitude that the test finds in nine of ten data sets.

    Infinite where more than ten thousand prior standard deviations would be needed.

    Parameters
    ----------
    test
        The test: its 5 % quantile is to be exceeded.
    signature
        The variant supposed true, one of the test's; the others are not given credit.
    parameter
        Which of its amplitudes, in the direction of its sign, positive where it has none.
    """
    sign = signature.signature.sign[parameter] or 1
    scale = float(signature.signature.prior_sd[parameter])
    direction = sign * scale * signature.gram[:, parameter]
    draws, threshold = _noise(signature), _threshold(test, signature)

    def found(multiple: float) -> float:
        return _detected_fraction(signature, draws + multiple * direction, threshold)

    if found(LARGEST) < DETECTED:
        return float("inf")
    low, high = SMALLEST, LARGEST
    while high > low * (1 + PRECISION):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if found(middle) >= DETECTED else (middle, high)
    return high * scale


def _threshold(test: ScoreTest, signature: ProjectedSignature) -> float:
    """The z-score of one variant from which on its effect is found."""
    factor = test.trials_factors[test.names.index(signature.signature.name)]
    log_tail = log_tail_of_z_score(np.array(test.quantile)) - np.log(factor)
    return float(z_score_of_log_tail(log_tail))


def _noise(signature: ProjectedSignature) -> Array:
    """Correlations of the signature with noise, shape ``(n, k)``, the same at every call."""
    size, vectors = np.linalg.eigh(signature.gram)
    draws = np.random.default_rng(POWER_SEED).standard_normal((POWER_DRAWS, signature.n_parameters))
    return np.asarray(draws @ (vectors * np.sqrt(np.maximum(size, 0.0))).T)


def _detected_fraction(
    signature: ProjectedSignature, correlations: Array, threshold: float
) -> float:
    return float(np.mean(signature.z_score(signature.gain(correlations)) >= threshold))
