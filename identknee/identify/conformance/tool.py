"""identknee's own profile as a tool for the conformance suite."""

import math

from identknee.identify.conformance.case import Answer, Case
from identknee.identify.profile import profile


def identknee_tool(case: Case) -> Answer:
    """The answer of `identknee.identify.profile.profile` with its default settings."""
    found = profile(case.problem, case.optimum, case.quantity, level=case.level)
    return Answer(
        intervals=tuple(
            (-math.inf if low is None else low, math.inf if high is None else high)
            for low, high in found.intervals
        ),
        lower=found.lower_status.value,
        upper=found.upper_status.value,
        verdict=found.verdict.value,
        n_simulations=found.n_simulations,
    )
