"""A fit that goes on from the equilibria it has found, where it would stop at a jump between two.

Two equilibria of a trial may lie closer together than either to the measured pose. Which of them is
found from there changes at a small step of the parameters, and a search that only goes down stops.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from identknee.calibrate.fit import BUDGET, Fit
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome
from identknee.verbs.used_trials import TrialSearch, UsedTrials, trial_names

# Simulations of the first search, and of those from each beginning; the best goes on.
FIRST, SHORT, LONG = 300, 60, 100
SHORT_ROUNDS, LONG_ROUNDS = 2, 12
# Share of the objective: a search that gains less is the last.
WORTHWHILE = 1e-3


class FollowedFit(NamedTuple):
    """A fit, the data it rests on, and the model that begins where it found the equilibria."""

    trials: TrialSearch
    used: UsedTrials
    found: Fit


def followed_fit(
    trials: TrialSearch, start: Array, search: Callable[..., Fit], budget: int | None
) -> FollowedFit:
    """The best of a few fits, each a chain of short searches from the equilibria of the last.

    They go on from where a first search ends, and from the strains of the measured poses. That
    search is the answer where it confirms a minimum or the model does not begin at measured poses.

    Parameters
    ----------
    trials
        Which trials a fit can rest on.
    start
        Theta to begin at, shape ``(p,)``.
    search
        `identknee.calibrate.fit.fit` by least squares with its settings.
    budget
        Simulations allowed; 2,500 if None.
    """
    began = time.perf_counter()
    allowed = BUDGET if budget is None else budget
    begins_at_poses = trials.model.poses is not None
    most = min(allowed, FIRST) if begins_at_poses else allowed
    used, found = trials.fitted(start, partial(search, budget=most))
    first = FollowedFit(trials=trials, used=used, found=found)
    stopped = (Outcome.VALLEY, Outcome.CLIFF, Outcome.BUDGET)
    if not begins_at_poses or allowed <= FIRST or found.outcome not in stopped:
        return first
    chain = _Chain(search, allowed, found)
    ends = [chain.followed(first, SHORT, SHORT_ROUNDS)]
    for theta in trials.stretched(start).values():
        begun = first._replace(found=replace(found, theta=theta, objective=np.inf))
        ends.append(chain.followed(begun, SHORT, SHORT_ROUNDS))
    best = chain.followed(min(ends, key=lambda x: x.found.objective), LONG, LONG_ROUNDS)
    used, found = best.used, best.found
    if len(trial_names(best.trials.with_equilibrium(found.theta))) > len(used.names):
        used, found = best.trials.refitted(replace(used, start=found.theta), chain.search)
    said = (
        "The search from the measured poses stopped without a minimum. It went on from the "
        f"equilibria it had found, and from {len(ends) - 1} other beginnings, and the best end was "
        f"taken ({chain.spent} simulations)."
    )
    used = replace(used, sentences=(*used.sentences, said))
    return FollowedFit(
        trials=best.trials, used=used, found=chain.whole(found, start, time.perf_counter() - began)
    )


class _Chain:
    """Searches of one fit, and the simulations they have made."""

    def __init__(self, search: Callable[..., Fit], allowed: int, first: Fit) -> None:
        self._search, self._allowed = search, allowed
        self.spent, self._history = first.n_simulations, [first.history]

    def search(self, *problem_and_start: object, fixed: object, budget: int = LONG) -> Fit:
        """One search within what is left of the budget."""
        left = max(min(budget, self._allowed - self.spent), 1)
        found = self._search(*problem_and_start, fixed=fixed, budget=left)
        self._history.append(np.add(found.history, [self.spent, 0.0]))
        self.spent += found.n_simulations
        return found

    def followed(self, begun: FollowedFit, size: int, rounds: int) -> FollowedFit:
        """The fit after searches of `size` simulations, the last of which gains next to nothing."""
        at = begun
        for _ in range(rounds):
            if self.spent >= self._allowed:
                break
            is_known = np.isfinite(at.found.objective)
            trials = at.trials.begun_at(at.found.theta) if is_known else at.trials
            problem = trials.problem(at.used.laxity)
            found = self.search(problem, at.found.theta, fixed=trials.fixed, budget=size)
            gained = at.found.objective - found.objective
            if not gained > 0.0:
                break
            at = at._replace(trials=trials, found=found)
            if gained < WORTHWHILE * found.objective or found.outcome is Outcome.MINIMUM:
                break
        return at

    def whole(self, found: Fit, start: Array, seconds: float) -> Fit:
        """The last search as the end of all."""
        is_spent = self.spent >= self._allowed
        stopped = found.outcome is Outcome.BUDGET and not is_spent
        outcome = Outcome.VALLEY if stopped else found.outcome
        history = np.concatenate(self._history)
        lowest = np.minimum.accumulate(history[:, 1])
        is_better = np.r_[True, lowest[1:] < lowest[:-1]]
        return replace(
            found,
            start=start,
            outcome=outcome,
            message=f"{outcome.sentence} It took {self.spent} simulations.",
            n_simulations=self.spent,
            budget=self._allowed,
            history=history[is_better],
            seconds=seconds,
        )
