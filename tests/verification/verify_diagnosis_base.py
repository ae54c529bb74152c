"""The fit without causes of a diagnosis of the measured knee, against one begun at that of `fit`.

Both compare one model with one table, so that the lower of the two is what the other should find.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from kept_outcomes import KeptOutcomes
from requirement_rows import Measure, Row

import identknee as ik
from identknee.checks.usable_trials import knee_with_equilibria
from identknee.diagnosis.base_fit import FURTHER, fit_base, lowest_fit, with_wider_priors
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import with_stated_uncertainty
from identknee.verbs.identification import with_noise

KEPT = KeptOutcomes("diagnosis_base")
KNEES, UNCERTAIN = (
    ("s192803", "s192803_bundles"),
    "registration=4deg,registration=4mm,insertions=4mm",
)
NOISE, APART = "1mm,1.5deg", 0.1


def measure(options: argparse.Namespace) -> Row:
    """How far the base fit of a diagnosis lies above the same begun at the parameters of `fit`."""
    tasks = [(name, priors) for name in KNEES for priors in (True, False)]
    named = {f"{x}, {_priors(with_them)}": (x, with_them) for x, with_them in tasks}
    KEPT.compute({key: partial(_outcome, *x) for key, x in named.items()}, options.workers)
    return _row(KEPT.known())


def _priors(with_them: bool) -> str:
    return "with priors" if with_them else "data alone"


def _outcome(name: str, priors: bool) -> dict[str, Any]:
    knee = ik.example(name)
    knee = knee.with_uncertainty(with_stated_uncertainty(knee.uncertainty, UNCERTAIN))
    fitted = ik.fit(
        name,
        name.removesuffix("_bundles"),
        uncertain=UNCERTAIN,
        noise=NOISE,
        weighting="noise",
        priors=priors,
    )
    data = with_noise(fitted.data, NOISE)
    parameters = LaxityModel(knee=knee, protocol=data.protocol).parameters
    if not priors:
        knee = with_wider_priors(knee, parameters, parameters.names_of_interest)
    begun, used = knee_with_equilibria(knee, data, "subject")
    at = dict(zip(fitted.search.parameters.names, fitted.search.theta.tolist(), strict=True))
    found = {}
    for what, which in (("alone", begun), ("from_fit", replace(begun, fitted=at))):
        base = fit_base(which, used.laxity, starts=[], seed=0)
        assert base is not None
        found[what] = lowest_fit(base, 0, FURTHER).fitted.deviance
    return found


def _row(known: Mapping[str, Mapping[str, Any]]) -> Row:
    measures = [
        Measure(
            what=f"{key}: alone above begun at that of fit",
            value=max(x["alone"] - x["from_fit"], 0.0),
            unit="1",
            bar=APART,
        )
        for key, x in known.items()
    ]
    return Row(
        line="diagnose of s192803 and s192803_bundles: the fit without causes within 0.1 of the "
        "lowest that is known, with and without priors of ligament parameters",
        measures=measures,
        notes=[f"{key}: {x['alone']:.3f} and {x['from_fit']:.3f}" for key, x in known.items()],
    )
