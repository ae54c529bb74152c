"""Equivalent sets of two knees: as many, as different and as certain as asked for."""

import argparse
from dataclasses import replace
from functools import partial

import numpy as np
from knees import model, own_laxity
from requirement_rows import Measure, Row, largest_of
from scipy.spatial.distance import pdist

from identknee.calibrate.bounded_least_squares import solve_constrained
from identknee.calibrate.problem import Evaluator, ParameterQuantity
from identknee.identify.equivalents import EquivalentSets, equivalents, longest_axes, points_along
from identknee.identify.region import Region, RegionView, noise_region
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import ligament_forces
from identknee.model.residuals import LaxityResiduals, largest_loads, rms_blocks
from identknee.runs.declare import Array

SD = 0.5
N_SETS = 100
N_RAYS, RAYS_SEED = 500, 77
# Of the limit, as everywhere where a point counts as inside.
TOLERANCE = 1e-6


def measure(options: argparse.Namespace) -> Row:
    """The bars on sets, and an independent look at the extrema."""
    measures, notes = [], []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        protocol = subject.protocol.select(largest_loads(subject.protocol))
        forces = ligament_forces(subject, protocol)
        for criterion, region in regions(subject).items():
            found = equivalents(region, quantities=forces, n_sets=N_SETS)
            say = partial("{}, {}: {}".format, name, criterion)
            measures += [*of_sets(found, say), resimulated(found, region, subject, say)]
            measures += random_points(found, region, say)
            if criterion == "noise":
                measures.append(profile_ends(found, region, say))
            notes.append(say(told(found)))
    return Row(
        line="equivalents: at least 100 sets, the farthest pair >= 0.9 of the diameter found by "
        "constrained maximisation, no two closer than 0.02 of it, each verified by simulation",
        measures=measures,
        notes=notes,
    )


def regions(subject: LaxityModel) -> dict[str, Region]:
    """Both criteria around the subject's own parameters, data without noise."""
    center = subject.parameters.center
    laxity = own_laxity(subject)
    stated = replace(laxity, sd=add_noise(laxity, sd_mm=SD, sd_deg=SD, seed=0).sd)
    whitened = LaxityResiduals(model=subject, laxity=stated, weighting="noise")
    plain = LaxityResiduals(model=subject, laxity=laxity)
    return {
        "noise": noise_region(whitened, center),
        "paper": Region(problem=plain, center=center, blocks=rms_blocks(plain)),
    }


def of_sets(found: EquivalentSets, say: "partial[str]") -> list[Measure]:
    """How many sets, and how different."""
    farthest, closest = found.farthest / found.diameter, found.closest / found.diameter
    return [
        Measure(what=say("sets"), value=len(found.sets), unit="", bar=N_SETS, at_least=True),
        Measure(what=say("farthest"), value=farthest, unit="diameters", bar=0.9, at_least=True),
        Measure(what=say("closest"), value=closest, unit="diameters", bar=0.02, at_least=True),
    ]


def resimulated(
    found: EquivalentSets, region: Region, subject: LaxityModel, say: "partial[str]"
) -> Measure:
    """The largest block at any set or extremum, simulated by a model that knows none of them."""
    assert isinstance(region.problem, LaxityResiduals)
    fresh = replace(region.problem, model=LaxityModel(knee=subject.knee, protocol=subject.protocol))
    view = RegionView(replace(region, problem=fresh))
    ends = [side.theta for x in found.extrema for side in (x.lower, x.upper)]
    largest = [view(theta).largest for theta in [*found.sets, *found.pair, *ends]]
    what = say("largest difference over the limit, simulated afresh")
    return largest_of(what, np.array(largest), "", bar=1.0 + TOLERANCE)


def random_points(found: EquivalentSets, region: Region, say: "partial[str]") -> list[Measure]:
    """Whether points inside on further random rays go beyond what the searches found."""
    view = RegionView(region)
    generator = np.random.default_rng(RAYS_SEED)
    origins = np.vstack([found.fit, found.sets])
    points = []
    for origin in origins[generator.integers(len(origins), size=N_RAYS)]:
        turn = generator.standard_normal(found.fit.size)
        turn /= np.linalg.norm(turn)
        points += points_along(view, origin, turn @ longest_axes(view, origin), 0.5)
    parameters = tuple(found.parameters.values())
    low = np.array([x.lower.value for x in parameters])
    high = np.array([x.upper.value for x in parameters])
    inside = np.array(points)
    beyond = (np.maximum(low - inside, inside - high) / (high - low)).max(axis=1)
    farthest = float(pdist(inside / found.steps).max()) / found.diameter
    return [
        largest_of(say("random points beyond the extrema"), beyond, "of the range", bar=TOLERANCE),
        Measure(
            what=say(f"farthest of {len(points)} random points"),
            value=farthest,
            unit="diameters",
            bar=1.0 + TOLERANCE,
        ),
    ]


def profile_ends(found: EquivalentSets, region: Region, say: "partial[str]") -> Measure:
    """How far the least deviance at the extrema of the parameters is from the limit."""
    errors: list[float] = []
    for name, extrema in found.parameters.items():
        quantity = ParameterQuantity(parameters=region.problem.parameters, name=name)
        for side in (extrema.lower, extrema.upper):
            evaluator = Evaluator(region.problem)
            held = solve_constrained(evaluator, found.fit, quantity=quantity, target=side.value)
            errors.append(abs(held.evaluation.deviance / found.limit - 1.0))
    what = say("deviance of a profile at an extremum, from the limit")
    return largest_of(what, np.array(errors), "of the limit", bar=1e-4)


def told(found: EquivalentSets) -> str:
    """What it took, and how the extrema ended."""
    sides = [side for x in found.extrema for side in (x.lower, x.upper)]
    ends = sorted({side.end.value for side in sides})
    counts = ", ".join(f"{sum(s.end.value == end for s in sides)} {end}" for end in ends)
    alone = sum(side.n_agreeing < 2 for side in sides)
    searches: Array = found.pair_searches
    agreeing = int(np.sum(searches > 0.999 * found.diameter))
    return (
        f"{found.n_simulations} simulations, diameter {found.diameter:.3g} "
        f"typical steps ({agreeing} of {len(searches)} searches within 0.1 %), {len(sides)} "
        f"extrema: {counts}; {alone} found by one search only"
    )
