"""Which default `--priors` should have: coverage of 95 % intervals, by where truths come from.

Truths are drawn from the priors, from priors twice as wide, and uniformly within the bounds. Each
data set is profiled with the priors of ligament parameters and without.
"""

import argparse
from functools import partial
from typing import Any

import numpy as np
from kept_outcomes import KeptOutcomes
from requirement_rows import Measure, Row
from scipy.stats import beta

import identknee as ik
from identknee.identify.profile.result import SideStatus
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters

KEPT = KeptOutcomes("priors")
TRUTHS = ("prior", "twice", "uniform")
N_SETS, MOST_DRAWS = 20, 200
SD = 0.5
# Of 63 trials every third.
STEP = 3
NAMES = {True: "with priors", False: "data alone"}


def measure(options: argparse.Namespace) -> Row:
    """Coverage and width by truths, with priors and without."""
    tasks = [(truths, i) for truths in TRUTHS for i in range(N_SETS)]
    KEPT.compute({f"{x}:{i}": partial(_outcome, x, i) for x, i in tasks}, options.workers)
    return _row(KEPT.known())


def _drawn(parameters: Parameters, truths: str, generator: np.random.Generator) -> np.ndarray:
    if truths == "uniform":
        return generator.uniform(parameters.lower, parameters.upper)
    wide = {"prior": 1.0, "twice": 2.0}[truths]
    steps = wide * parameters.prior_sd * generator.standard_normal(parameters.n)
    center = parameters.center
    theta = np.where(parameters.is_log, center * np.exp(steps), center + steps)
    return np.clip(theta, parameters.lower, parameters.upper)


def _outcome(truths: str, number: int) -> dict[str, Any]:
    """Whether each interval of a data set covers its truth, and how wide it is."""
    generator = np.random.default_rng([number, TRUTHS.index(truths)])
    knee = ik.reference_knee()
    whole = ik.load_protocol("seed63")
    protocol = whole.select(list(range(0, whole.n, STEP)))
    model = LaxityModel(knee=knee, protocol=protocol)
    for _ in range(MOST_DRAWS):
        theta = _drawn(model.parameters, truths, generator)
        prediction = model.predict(theta, derivatives=False)
        if prediction.is_converged.all():
            break
    laxity = ik.add_noise(
        ik.Laxity(protocol=protocol, coordinates=prediction.coordinates),
        sd_mm=SD,
        sd_deg=SD,
        seed=number,
    )
    found: dict[str, Any] = {}
    for priors, name in NAMES.items():
        profiles = ik.profile(knee, laxity, priors=priors).parameters
        covers, widths = [], []
        for own, truth, low, high in zip(
            profiles.values(),
            theta,
            model.parameters.lower,
            model.parameters.upper,
            strict=True,
        ):
            ends = [
                bound if side.end is None or side.status is not SideStatus.CLOSED else side.end
                for side, bound in ((own.lower_side, low), (own.upper_side, high))
            ]
            covers.append(bool(ends[0] <= truth <= ends[1]))
            widths.append((ends[1] - ends[0]) / (high - low))
        found[name] = {"covers": covers, "widths": widths}
    return found


def _row(known: dict[str, dict[str, Any]]) -> Row:
    measures, notes = [], []
    for truths in TRUTHS:
        own = [x for key, x in known.items() if key.partition(":")[0] == truths]
        for name in NAMES.values():
            covers = np.array([x[name]["covers"] for x in own])
            k, n = int(covers.sum()), covers.size
            low, high = beta.ppf([0.025, 0.975], [k, k + 1], [n - k + 1, max(n - k, 1e-9)])
            width = float(np.median([x[name]["widths"] for x in own]))
            said = f"truths from {truths}, {name}"
            notes.append(
                f"{said}: {k} of {n} intervals cover ({100 * low:.1f} to {100 * high:.1f} %), "
                f"median width {100 * width:.1f} % of the bounds, {len(own)} data sets"
            )
            if name == NAMES[False]:
                measures.append(
                    Measure(
                        what=f"{said}: coverage", value=k / n, unit="1", bar=0.93, at_least=True
                    )
                )
    return Row(
        line="95 % intervals of the default, which is the data alone, cover truths drawn from the "
        "priors, from priors twice as wide and uniformly within the bounds",
        measures=measures,
        notes=notes,
    )
