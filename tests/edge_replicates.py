"""Whole profiles of simulated data on knees whose feasible set has edges near the truth."""

from functools import lru_cache
from typing import Any

import numpy as np
from knees import model
from narrow_knee import narrow_knee

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.evaluation import Evaluator
from identknee.identify.profile.profile import profile_parameters
from identknee.identify.profile.result import Profile
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals

NOISE = 0.5  # mm and deg
# Share of the reference knee's plateau width: five trials of seed63 come near a rim.
NARROW = 0.8


@lru_cache(maxsize=2)
def edge_model(knee: str) -> LaxityModel:
    """The model of ``"lenhart2015"``, which folds, or of ``"narrow"`` under the 63 trials."""
    if knee == "narrow":
        return LaxityModel(knee=narrow_knee(NARROW), protocol=load_protocol("seed63"))
    return model(knee)


@lru_cache(maxsize=2)
def _laxity(knee: str) -> Laxity:
    return edge_model(knee).simulate(edge_model(knee).parameters.center)


def edge_replicate(task: tuple[str, tuple[int, ...]]) -> dict[str, Any]:
    """How the sets of all parameters ended for the data of one seed, and whether they cover.

    The fit begins at the truth, which finds the lowest minimum sooner than many starts; a better
    one met by a profile starts all over, as for a user.
    """
    knee, seed = task
    laxity = add_noise(_laxity(knee), sd_mm=NOISE, sd_deg=NOISE, seed=np.random.SeedSequence(seed))
    problem = LaxityResiduals(model=edge_model(knee), laxity=laxity, weighting="noise")
    truth = problem.parameters.center
    best = minimise(Evaluator(problem), truth, tolerance=1e-6)
    profiles = profile_parameters(problem, best.evaluation.theta, starts=())
    return {
        "covers": [_covers(x, float(y)) for x, y in zip(profiles, truth, strict=True)],
        "lower": [x.lower_status.value for x in profiles],
        "upper": [x.upper_status.value for x in profiles],
        "verdicts": [x.verdict.value for x in profiles],
        "n_simulations": sum(x.n_simulations for x in profiles),
    }


def _covers(profile: Profile, truth: float) -> bool:
    """Whether the truth lies in the set, an end that is said to be open being infinite."""
    return any(
        (low is None or low <= truth) and (high is None or truth <= high)
        for low, high in profile.intervals
    )
