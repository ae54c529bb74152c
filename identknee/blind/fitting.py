"""The signal of an effect: what the ligament parameters cannot absorb; and the size for it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identknee.blind.experiment import Experiment, Run, conduct, theta_slopes
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry

# Of the chi-square between two steps, and of the wanted signal.
FIT_TOLERANCE = 1e-3
SIGNAL_TOLERANCE = 0.02
FIT_STEPS = 25
AMPLITUDE_STEPS = 12
LEAST_STIFFNESS_KN = 0.05
# Share of the largest amplitude that the search starts from, and the most it changes by at once.
FIRST_SHARE = 0.05
LARGEST_FACTOR = 6.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """Size of the errors of a trial: standard deviations [mm], [deg] and what they share."""

    sd_mm: float
    sd_deg: float
    correlation: float

    def whitened(self, values: Array) -> Array:
        """Values ``(n, 5, ...)`` in units of independent errors of size 1."""
        shared = np.full((5, 5), self.correlation)
        np.fill_diagonal(shared, 1.0)
        sd = np.array([self.sd_mm] * 3 + [self.sd_deg] * 2)
        inverse = np.linalg.inv(np.linalg.cholesky(sd[:, None] * shared * sd))
        white: Array = np.einsum("ij,nj...->ni...", inverse, values)
        return white


@declared
class BaseFit:
    """The best fit of the ligament parameters alone."""

    theta: Array = entry("Stiffnesses [kN], then reference strains [%]")
    run: Run = entry("The run there")
    signal: float = entry("Root of the chi-square left")


@declared
class Scaled:
    """An amplitude for a wanted signal."""

    amplitude: float = entry("Amplitude in the effect's unit, > 0")
    signal: float = entry("Signal that it gives")
    is_largest: bool = entry(
        "Whether the search ended at the largest plausible amplitude short of the wanted signal"
    )


def left_over(slopes: Array, change: Array, noise: Noise) -> float:
    """Length of what `slopes` (n, 5, p) cannot absorb of a `change` (n, 5), in units of noise."""
    columns = noise.whitened(slopes).reshape(-1, slopes.shape[2])
    white = noise.whitened(change).ravel()
    share = np.linalg.lstsq(columns, white, rcond=None)[0]
    return float(np.linalg.norm(white - columns @ share))


def base_fit(base: Experiment, target: Array, noise: Noise, start: BaseFit) -> BaseFit:
    """Best fit of `base`, an experiment without effect, to coordinates `target` ``(n, 5)``.

    Damped Gauss-Newton from a fit nearby. A step after which a trial has no equilibrium is refused
    like one that fits worse.
    """
    m = len(start.theta) // 2
    theta, run = start.theta, start.run
    residual = noise.whitened(run.coordinates - target).ravel()
    damping = 1e-3
    for _ in range(FIT_STEPS):
        slopes = noise.whitened(theta_slopes(base.with_theta(theta), run, m)).reshape(-1, 2 * m)
        normal, slope = slopes.T @ slopes, slopes.T @ residual
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), slope)
        new = theta + step
        new[:m] = np.maximum(new[:m], LEAST_STIFFNESS_KN)
        new_run = conduct(base.with_theta(new), run)
        gained = -1.0
        if new_run.is_complete:
            new_residual = noise.whitened(new_run.coordinates - target).ravel()
            gained = float(residual @ residual - new_residual @ new_residual)
        if gained < 0.0:
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e6:
                break
            continue
        theta, run, residual = new, new_run, new_residual
        damping *= 0.1
        if gained <= FIT_TOLERANCE * max(1.0, float(residual @ residual)):
            break
    return BaseFit(theta=theta, run=run, signal=float(np.sqrt(residual @ residual)))


def scaled_to(
    projected: Callable[[float], float | None],
    fitted: Callable[[float], float | None],
    wanted: float,
    largest: float,
) -> Scaled | None:
    """The amplitude whose signal is `wanted`, at most `largest`; None where a trial fails.

    Parameters
    ----------
    projected, fitted
        Signal at an amplitude: what the slopes of the parameters leave of its effect, and what
        their best fit leaves, which takes longer; None where a trial has no equilibrium.
    wanted, largest
        Signal to reach, and the end of the search.
    """
    found = _searched(projected, wanted, FIRST_SHARE * largest, largest)
    if found is None:
        return None
    return _searched(fitted, wanted, found.amplitude, largest)


def _searched(
    signal_of: Callable[[float], float | None], wanted: float, amplitude: float, largest: float
) -> Scaled | None:
    known: list[tuple[float, float]] = []
    for _ in range(AMPLITUDE_STEPS):
        signal = signal_of(amplitude)
        if signal is None:
            return None
        known.append((amplitude, signal))
        is_largest = signal < wanted and amplitude >= largest
        if is_largest or abs(signal / wanted - 1.0) < SIGNAL_TOLERANCE:
            return Scaled(amplitude=amplitude, signal=signal, is_largest=is_largest)
        amplitude = min(largest, _next(known, wanted))
    return Scaled(amplitude=known[-1][0], signal=known[-1][1], is_largest=False)


def _next(known: list[tuple[float, float]], wanted: float) -> float:
    """Where the signal, a power of the amplitude, should be as wanted."""
    below = [x for x in known if x[1] < wanted]
    above = [x for x in known if x[1] >= wanted]
    last = known[-1]
    power = 1.0
    if len(known) > 1 and known[-2][0] != last[0] and known[-2][1] > 0.0 < last[1]:
        power = np.log(last[1] / known[-2][1]) / np.log(last[0] / known[-2][0])
        power = float(np.clip(power, 0.4, 3.0))
    guess = last[0] * float(
        np.clip((wanted / max(last[1], 1e-6)) ** (1.0 / power), 1 / LARGEST_FACTOR, LARGEST_FACTOR)
    )
    if below and above:
        low, high = max(below)[0], min(above)[0]
        if low < high and not low < guess < high:
            guess = float(np.sqrt(low * high))
    return guess
