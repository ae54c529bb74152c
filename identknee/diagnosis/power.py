"""Which amplitude of an effect the max-score test would find, and what its silence means."""

from enum import Enum, unique

import numpy as np

from identknee.diagnosis.score import ScoreTest
from identknee.diagnosis.signature import ProjectedSignature
from identknee.diagnosis.tails import deviate_of_log_tail, log_tail_of_deviate
from identknee.runs.arrays import Array

# An effect that would be found this often counts as one the data can exclude.
HIGH_POWER = 0.75
N_DRAWS, SEED = 1000, 0
# Prior standard deviations within which a detectable amplitude is looked for, and its precision.
SMALLEST, LARGEST, PRECISION = 1e-4, 1e4, 1e-3


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
    """The deviate of one variant from which on its effect is found."""
    factor = test.trials_factors[test.names.index(signature.signature.name)]
    log_tail = log_tail_of_deviate(np.array(test.quantile)) - np.log(factor)
    return float(deviate_of_log_tail(log_tail))


def _noise(signature: ProjectedSignature) -> Array:
    """Correlations of the signature with noise, shape ``(n, k)``, the same at every call."""
    size, vectors = np.linalg.eigh(signature.gram)
    draws = np.random.default_rng(SEED).standard_normal((N_DRAWS, signature.n_parameters))
    return np.asarray(draws @ (vectors * np.sqrt(np.maximum(size, 0.0))).T)


def _share_found(signature: ProjectedSignature, correlations: Array, threshold: float) -> float:
    return float(np.mean(signature.deviate(signature.gain(correlations)) >= threshold))
