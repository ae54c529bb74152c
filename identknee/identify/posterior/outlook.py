"""How long a sample still needs: how many steps, judged from its convergence so far."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from identknee.identify.posterior.convergence import ConvergenceCheck

# Of checks to come, before one of them is said never to pass.
MOST_CHECKS = 1000
# A drift times the steps: its typical size beside that of the largest of so many independent
# normal errors, and the spread of its logarithm. From 7 samples of two knees with 8 parameters.
DRIFT_SIZE, DRIFT_SPREAD = 1.27, 0.5
# Checks that this counts for beside those made, the first of which are of too few steps to tell.
PRIOR_CHECKS, FIRST_CHECKS = 10, 2


def expected_steps(checks: Sequence[ConvergenceCheck]) -> float:
    """Steps of every walker at which all conditions are expected to be met; infinite if unknown.

    Effective draws grow with the steps, errors of means fall with their root, and R-hat comes down
    to 1 as their inverse. The drift of the autocorrelation time is its own noise: it falls as the
    inverse of the steps on average, and sampling ends when it happens to be small enough, as
    likely earlier as later than said here.
    """
    latest = checks[-1]
    if latest.is_passed:
        return float(latest.steps)
    found = {name: (value, bar) for name, (value, bar, _) in latest.conditions.items()}
    at_least = ("steps_per_tau", "effective_draws", "effective_draws_each")
    needed = [found[x][1] / found[x][0] if found[x][0] > 0.0 else np.inf for x in at_least]
    value, bar = found["mean_error"]
    needed.append((value / bar) ** 2)
    value, bar = found["rhat"]
    needed.append((value - 1.0) / (bar - 1.0))
    return max(latest.steps * max(1.0, *needed), _drift_steps(checks))


def outlook(checks: Sequence[ConvergenceCheck], spent: float) -> tuple[float, str]:
    """Steps at which sampling is expected to end, and the state of its convergence in words.

    Parameters
    ----------
    checks
        All checks so far.
    spent
        Share of the budget that is used up.
    """
    latest = checks[-1]
    found = latest.conditions
    length, wanted, _ = found["steps_per_tau"]
    words = (
        f"R-hat {found['rhat'][0]:.3f} of {found['rhat'][1]:g}, "
        f"{length:.0f} of {wanted:g} autocorrelation times, {spent:.0%} of the budget"
    )
    return min(expected_steps(checks), latest.steps / max(spent, 1e-9)), words


def _drift_steps(checks: Sequence[ConvergenceCheck]) -> float:
    """Steps by which every other sample has found a drift below its bar."""
    if len(checks) < 2:
        return 0.0
    latest, seen = checks[-1], checks[FIRST_CHECKS:]
    block = latest.steps - checks[-2].steps
    scaled = [x.drift * x.steps for x in seen if np.isfinite(x.drift) and x.drift > 0.0]
    weight = PRIOR_CHECKS / (PRIOR_CHECKS + len(scaled))
    typical = weight * np.log(_drift_times_steps(latest, block))
    typical += (1.0 - weight) * np.mean(np.log(scaled or [1.0]))
    steps = latest.steps + block * np.arange(1, MOST_CHECKS + 1)
    small = ndtr((np.log(latest.rule.drift * steps) - typical) / DRIFT_SPREAD)
    passed = np.cumprod(1.0 - small) < 0.5
    return float(steps[np.argmax(passed)]) if passed.any() else np.inf


def _drift_times_steps(latest: ConvergenceCheck, block: float) -> float:
    """What the noise of autocorrelation times lets one expect.

    The error of one, estimated over a window of 5 of them, is that of Sokal; it changes with the
    steps since the check that it is compared with.
    """
    tau = float(np.max(latest.tau))
    since = block * np.ceil(tau / block)
    error = np.sqrt(2.0 * (10.0 * tau + 1.0) / latest.acceptance.size * since)
    largest = ndtri((1.0 + 0.5 ** (1.0 / len(latest.tau))) / 2.0)
    return float(DRIFT_SIZE * largest * error)
