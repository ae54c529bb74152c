"""Scores of every candidate cause on one scale, and which amplitudes they would show."""

from collections.abc import Sequence
from enum import Enum, unique
from typing import Literal

import numpy as np

from identknee.diagnosis.score.misfit import Projector, log_tail_of_z_score, z_score_of_log_tail
from identknee.diagnosis.score.signature import (
    ProjectedSignature,
    Signature,
    effect_names,
    project_signature,
)
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import declared, entry

Scale = Literal["known", "unknown"]
N_DRAWS = 4000
# The probability of a false alarm at which the quantile is taken.
LEVEL = 0.05
# A z-score below it is the root of a rounding error, and would order causes by the processor.
ROUNDED_SCORE = 1e-6
# Residuals smaller than this share of the noise are what a search or rounding left, no measurement.
ROUNDED_RESIDUAL = 1e-4
# An effect that would be found this often counts as one the data can exclude.
HIGH_POWER = 0.75
POWER_DRAWS, POWER_SEED = 1000, 0
# Prior standard deviations within which a detectable amplitude is looked for, and its precision.
SMALLEST, LARGEST, PRECISION = 1e-4, 1e4, 1e-3


@declared
class CandidateScore:
    """How strongly residuals speak for one candidate cause."""

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

    def named(self, name: str) -> CandidateScore:
        """The score of the effect `name`."""
        return next(x for x in self.candidates if x.name == name)


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
        found = [
            self._candidate(self.names[i], float(scores[i]), z_scores[0], residuals)
            for i in np.argsort(-scores, kind="stable")
        ]
        return Scores(candidates=tuple(found), quantile=self.quantile)

    def _candidate(
        self, name: str, score: float, z_scores: Array, residuals: Array
    ) -> CandidateScore:
        own = [i for i, x in enumerate(self.signatures) if x.signature.name == name]
        best = self.signatures[max(own, key=lambda i: z_scores[i])]
        correlations = self.projector.project(residuals)[None] @ best.projected
        return CandidateScore(
            name=name,
            variant=best.signature.variant,
            score=score,
            p_value=self.p_value(score),
            amplitude=frozen(best.amplitude(correlations)[0], None, name="amplitude"),
            covariance=frozen(best.covariance, None, None, name="covariance"),
            gain=float(best.gain(correlations)[0]),
            share_left=best.share_left,
        )


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
    draws = np.random.default_rng(seed).standard_normal((n_draws, projector.n_rows))
    z_scores = _z_scores(_in_units(draws, projector, scale), projected)
    scores = _by_name(z_scores, projected)
    factors = _trials_factors(scores, projected)
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


def _trials_factors(scores: Array, signatures: Sequence[ProjectedSignature]) -> Array:
    """By how much more often than one z-score the largest of each effect exceeds its quantile."""
    names = [x.signature.name for x in signatures]
    variants = np.array([names.count(x) for x in effect_names(signatures)], dtype=np.float64)
    quantiles = np.quantile(scores, 1 - LEVEL, axis=0)
    factors = LEVEL / np.exp(log_tail_of_z_score(quantiles))
    return np.asarray(np.clip(factors, 1.0, variants))


def _corrected(scores: Array, trials_factors: Array) -> Array:
    """Z-scores as rare as the largest of so many independent ones, 0 at least."""
    log_tails = log_tail_of_z_score(scores) + np.log(trials_factors)
    corrected = z_score_of_log_tail(log_tails)
    return np.where(corrected < ROUNDED_SCORE, 0.0, corrected)


@unique
class Cell(Enum):
    """What a score test says of one effect: significant or not, crossed with its power.

    References
    ----------
    W. E. Saris, A. Satorra and W. M. van der Veld, Testing structural equation models or detection
    of misspecifications?, Struct. Equ. Modeling 16 (2009) 561-582, doi:10.1080/10705510903203433.
    """

    MISSPECIFIED = "misspecified"
    INSPECT = "inspect"
    EXCLUDED = "excluded"
    INCONCLUSIVE = "inconclusive"

    @property
    def sentence(self) -> str:
        """What that means, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Cell.MISSPECIFIED: "The effect is seen although the test would often miss one that matters.",
    Cell.INSPECT: "The effect is seen, and the test sees small ones too: its amplitude decides.",
    Cell.EXCLUDED: "The effect is not seen, and one that matters would have been.",
    Cell.INCONCLUSIVE: "The effect is not seen, but one that matters could have been missed.",
}


def judge(*, is_significant: bool, power: float) -> Cell:
    """What a score says, given the power to find an amplitude that matters."""
    is_powerful = power >= HIGH_POWER
    if is_significant:
        return Cell.INSPECT if is_powerful else Cell.MISSPECIFIED
    return Cell.EXCLUDED if is_powerful else Cell.INCONCLUSIVE


def detection_power(test: ScoreTest, signature: ProjectedSignature, amplitude: Array) -> float:
    """How often the test would find the effect, by simulation.

    Parameters
    ----------
    test
        The test: its 5 % quantile is to be exceeded.
    signature
        The variant supposed true, one of the test's; the others are not given credit.
    amplitude
        Its amplitudes, shape ``(k,)``.
    """
    draws = _noise(signature)
    return _share_found(signature, draws + signature.gram @ amplitude, _threshold(test, signature))


def detectable_amplitude(
    test: ScoreTest, signature: ProjectedSignature, parameter: int, *, power: float = 0.9
) -> float:
    """The size of one amplitude alone that the test finds that often.

    Infinite where more than ten thousand prior standard deviations would be needed.

    Parameters
    ----------
    test
        The test: its 5 % quantile is to be exceeded.
    signature
        The variant supposed true, one of the test's; the others are not given credit.
    parameter
        Which of its amplitudes, in the direction of its sign, positive where it has none.
    power
        Share of data sets in which it is to be found.
    """
    sign = signature.signature.sign[parameter] or 1
    scale = float(signature.signature.prior_sd[parameter])
    direction = sign * scale * signature.gram[:, parameter]
    draws, threshold = _noise(signature), _threshold(test, signature)

    def found(multiple: float) -> float:
        return _share_found(signature, draws + multiple * direction, threshold)

    if found(LARGEST) < power:
        return float("inf")
    low, high = SMALLEST, LARGEST
    while high > low * (1 + PRECISION):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if found(middle) >= power else (middle, high)
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


def _share_found(signature: ProjectedSignature, correlations: Array, threshold: float) -> float:
    return float(np.mean(signature.z_score(signature.gain(correlations)) >= threshold))
