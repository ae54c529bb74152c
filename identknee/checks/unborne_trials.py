"""Trials that a knee would not bear: a ligament would fail, or the tibia would move too far.

Tensions and motions of trials that were made raise the limits, because the knee bore them.
"""

from collections.abc import Sequence

import numpy as np

from identknee.checks.fit_checks import strength_tensions
from identknee.laxity.table import COORDINATES
from identknee.model.candidate_laxity import continued_from_own_poses
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array, declared, entry
from identknee.runs.findings import Finding, finding
from identknee.runs.words import coordinate_words

# Largest change of a coordinate from the unloaded pose [mm, deg]: an assumption.
FARTHEST = dict(zip(COORDINATES, (25.0, 25.0, 25.0, 20.0, 30.0), strict=True))
ASSUMED = "an assumption"


@declared
class UnborneTrial:
    """A trial or step that is not offered, since no knee would bear it."""

    trial: str = entry("Name of the trial or step")
    what: str = entry("The ligament that would fail, or the coordinate that would go too far")
    value: float = entry(
        "Predicted tension, or size of the change from the unloaded pose", unit="N, mm or deg"
    )
    limit: float = entry(
        "Mean load at which such a ligament fails, or farthest change; more where a trial that was "
        "made had more",
        unit="N, mm or deg",
    )
    source: str = entry("Where the limit is from")


@declared
class Bearable:
    """The largest tension of each ligament and change of each coordinate that a knee bears."""

    what: tuple[str, ...] = entry("Names of ligaments and coordinates")
    limits: Array = entry("The limits [N, mm, deg], shape ``(m,)``")
    sources: tuple[str, ...] = entry("Where they are from")

    def unborne(self, model: LaxityModel, theta: Array) -> tuple[UnborneTrial, ...]:
        """The trials of a model beyond a limit at theta, each with the limit it exceeds most."""
        values = _demands(model, theta)[2]
        times = np.nan_to_num(values / self.limits)
        return tuple(
            UnborneTrial(
                trial=model.protocol.trials[i],
                what=self.what[k],
                value=float(values[i, k]),
                limit=float(self.limits[k]),
                source=self.sources[k],
            )
            for i, k in enumerate(times.argmax(axis=1))
            if times[i, k] > 1.0
        )


def bearable(model: LaxityModel, theta: Array, *, is_made: bool) -> Bearable:
    """The limits of a knee; if its trials were made (`is_made`), at least their values at theta."""
    names, usual, values, sources = _demands(model, theta)
    borne = np.nan_to_num(values).max(axis=0) if is_made else np.zeros(len(usual))
    return Bearable(what=names, limits=np.maximum(usual, borne), sources=sources)


def _demands(
    model: LaxityModel, theta: Array
) -> tuple[tuple[str, ...], Array, Array, tuple[str, ...]]:
    """Names, limits, tensions and motions ``(n, m)``, NaN without equilibrium, and sources."""
    unloaded = model.protocol.under(np.zeros(model.protocol.n))
    at_rest = continued_from_own_poses(model.with_protocol(unloaded), theta)
    found, rest = (x.predict(theta, derivatives=False) for x in (model, at_rest))
    changes = np.abs(found.coordinates - rest.coordinates)
    known = strength_tensions(model, found)
    return (
        (*known, *FARTHEST),
        np.array([*(x.failure_N for x in known.values()), *FARTHEST.values()]),
        np.column_stack([*(x.tension for x in known.values()), changes]),
        (*(x.source for x in known.values()), *[ASSUMED] * len(FARTHEST)),
    )


def unborne_findings(unborne: Sequence[UnborneTrial]) -> tuple[Finding, ...]:
    """A finding for each ligament or coordinate whose limit rules out trials, with the worst."""
    found = []
    for what in dict.fromkeys(x.what for x in unborne):
        own = [x for x in unborne if x.what == what]
        worst = max(own, key=lambda x: x.value)
        counted = f"{len(own)} possible {'step is' if len(own) == 1 else 'steps are'} not offered"
        values = {"n": len(own), "trial": worst.trial, "trials": [x.trial for x in own]}
        if what in FARTHEST:
            unit = what.rpartition("_")[2]
            values |= {
                "coordinate": what,
                f"change_{unit}": worst.value,
                f"limit_{unit}": worst.limit,
            }
            sentence = (
                f"{counted}: {coordinate_words(what)} would change by up to {worst.value:.0f} "
                f"{unit}, in {worst.trial}; {worst.limit:.0f} {unit} is taken as the limit."
            )
            found.append(finding("step-beyond-laxity", what, values, sentence=sentence))
            continue
        values |= {
            "ligament": what,
            "force_N": worst.value,
            "limit_N": worst.limit,
            "source": worst.source,
        }
        sentence = (
            f"{counted}: the {what} would carry up to {worst.value:.0f} N, in {worst.trial}; it "
            f"bears {worst.limit:.0f} N ({worst.source})."
        )
        found.append(finding("step-beyond-strength", what, values, sentence=sentence))
    return tuple(found)
