"""How long a sample still needs: how many steps, judged from its convergence so far."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from identknee.identify.posterior.convergence import ConvergenceCheck

# Of checks to come, before one of them is said never to pass.
MOST_CHECKS = 1000
# Chance that no check has passed by then; sampling ends sooner than draws of one kind suggest.
NONE_PASSED = 0.8


def expected_steps(checks: Sequence[ConvergenceCheck]) -> float:
    """Steps of every walker at which all conditions are expected to be met; infinite if unknown.

    Effective draws grow with the steps, errors of means fall with their root, and R-hat comes down
    to 1 as their inverse. The drift of the autocorrelation time is its own noise: it falls as the
    inverse of the steps on average, and sampling ends when it happens to be small enough.
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
    """Steps by which a check is expected to have found a drift below its bar."""
    scaled = [x.drift * x.steps for x in checks if np.isfinite(x.drift) and x.drift > 0.0]
    if len(scaled) < 2:
        return 0.0
    logs = np.log(scaled)
    latest, block = checks[-1], checks[-1].steps - checks[-2].steps
    steps = latest.steps + block * np.arange(1, MOST_CHECKS + 1)
    small = ndtr((np.log(latest.rule.drift * steps) - logs.mean()) / max(logs.std(ddof=1), 0.1))
    passed = np.cumprod(1.0 - small) < NONE_PASSED
    return float(steps[np.argmax(passed)]) if passed.any() else np.inf
