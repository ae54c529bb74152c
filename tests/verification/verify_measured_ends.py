"""Ends of the measured knee's profiles against many searches with a far larger budget.

An end is wrong by more than 2 % of its interval if parameters are likely that far outside, or none
are likely that far inside. So at both places the parameter is held and all others are fitted from
twenty starts, from where the profile's curve is expected, and from its points, which walk there.
Where a side is open, the fits lie where the profile stopped, and beyond. Rises count from the
lowest fit that the profiles or these searches found of the knee.
"""

import argparse
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from kept_outcomes import KeptOutcomes
from requirement_rows import Measure, Row
from verify_measured_knee import HOW, KNEES

import identknee as ik
from identknee.calibrate.bounded_least_squares import walk_to_constraint
from identknee.calibrate.fit import fit_many
from identknee.calibrate.problem import Evaluator, ParameterQuantity, Problem
from identknee.checks.left_out_trials import trials_asked
from identknee.identify.optimum import sobol_around
from identknee.runs.declare import Array
from identknee.subject.knee import with_stated_uncertainty
from identknee.verbs.identification import identification

KEPT = KeptOutcomes("measured_ends")
# Ten times what a brief search of a verb has.
N_STARTS, N_ALONG, BUDGET = 20, 4, 1_000
SHARE, REACH = 0.02, 2.0
# Deviance by which two fits of one minimum may differ.
TOLERANCE = 0.02
KEPT_OF_ENDS = ("name", "side", "status", "value", "width", "threshold", "deviance")
SIDES = {"lower": -1.0, "upper": 1.0}
MOST_WRONG = 1


def measure(options: argparse.Namespace) -> Row:
    """How many of the 16 ends of each knee differ from the reference."""
    KEPT.compute({f"{x}: profiles": partial(_profiles, x) for x in KNEES}, 1)
    tasks = {}
    for knee in KNEES:
        for end in KEPT.known()[f"{knee}: profiles"]["ends"]:
            key = f"{knee}: {end['name']} {end['side']}"
            tasks[key] = partial(_reference, knee, end)
    KEPT.compute(tasks, options.workers)
    return _row({key: KEPT.known()[key] for key in tasks})


def _profiles(knee: str) -> dict[str, Any]:
    """All ends of the profiles of a knee, each with the parameters near it."""
    found = ik.profile(
        knee, "s192803", priors=False, uncertain=HOW["uncertain"], noise=HOW["noise"]
    )
    ends = []
    for profile in found.parameters.values():
        for side in SIDES:
            at = profile.lower_side if side == "lower" else profile.upper_side
            value = at.reached if at.end is None else at.end
            near = np.argsort(np.abs(profile.values - value))[:N_ALONG]
            reach = [x for x in (profile.lower, profile.upper) if x is not None]
            reach += [profile.optimum_value] * (len(reach) < 2)
            ends.append(
                {
                    "name": profile.name,
                    "side": side,
                    "status": at.status.value,
                    "end": at.end,
                    "value": value,
                    "width": abs(reach[0] - reach[1]),
                    "deviance": profile.deviance,
                    "threshold": profile.threshold,
                    "optimum": profile.optimum.tolist(),
                    "near": profile.thetas[near].tolist(),
                }
            )
    return {"ends": ends, "n_simulations": found.n_simulations}


def _reference(knee: str, end: Mapping[str, Any]) -> dict[str, Any]:
    """The lowest deviance a little inside and a little outside an end."""
    subject = ik.read_subject(knee)
    stated = with_stated_uncertainty(subject.uncertainty, HOW["uncertain"])
    laxity = trials_asked(ik.read_laxity("s192803"), noise_mm=1.0).laxity
    setup = identification(subject.with_uncertainty(stated), laxity, noise=HOW["noise"])
    at_optimum = float(np.sum(setup.problem.residuals(np.array(end["optimum"])) ** 2))
    assert abs(at_optimum - end["deviance"]) < TOLERANCE, "another problem than that of profile"
    parameters = setup.problem.parameters
    place = parameters.index(end["name"])
    found = {}
    for where in ("inside", "outside"):
        away = SIDES[end["side"]] * SHARE * end["width"] * (1.0 if where == "outside" else -1.0)
        value = end["value"] + away
        if not parameters.lower[place] <= value <= parameters.upper[place]:
            continue
        starts = _starts(end, parameters, value)
        fits = fit_many(setup.everywhere, starts, fixed=(end["name"],), budget=BUDGET)
        squares = [float(np.sum(setup.problem.residuals(x.theta) ** 2)) for x in fits]
        found[where] = float(np.nanmin(squares + _walked(setup.problem, end, value)))
    return {"knee": knee, **{x: end[x] for x in KEPT_OF_ENDS}, **found}


def _starts(end: Mapping[str, Any], parameters: Any, value: float) -> Array:
    """The curve at a value, its points nearest to the end, and points around the optimum."""
    near, optimum = np.array(end["near"]), np.array(end["optimum"])
    place = parameters.index(end["name"])
    first, last = near[np.argsort(np.abs(near[:, place] - value))[:2]]
    step = (value - first[place]) / (last[place] - first[place])
    along = np.clip(first + step * (last - first), parameters.lower, parameters.upper)
    others = sobol_around(parameters, optimum, N_STARTS - len(near), reach=REACH, seed=0)
    starts = np.vstack([along, near, others])
    starts[:, place] = value
    return starts


def _walked(problem: Problem, end: Mapping[str, Any], value: float) -> list[float]:
    """Deviances where walks from the points nearest to an end come to a value.

    Set to the value at once, such a point may lose a trial, and a fit from it never get it back.
    """
    quantity = ParameterQuantity(parameters=problem.parameters, name=end["name"])
    walks = [
        walk_to_constraint(
            Evaluator(problem, budget=BUDGET), np.array(x), quantity=quantity, target=value
        )
        for x in end["near"]
    ]
    return [x.evaluation.deviance for x in walks if x.is_on_target]


def _fault(x: Mapping[str, Any], lowest: float) -> str:
    """What is wrong with an end; empty if nothing is."""
    inside, outside = x.get("inside", np.nan) - lowest, x.get("outside", np.nan) - lowest
    if x["status"] in ("open_budget", "failed"):
        return str(x["status"])
    if outside < x["threshold"] - TOLERANCE:
        return "reaches further"
    if inside > x["threshold"] + TOLERANCE:
        return "does not reach so far"
    return ""


def _row(outcomes: Mapping[str, Mapping[str, Any]]) -> Row:
    measures, notes = [], []
    for knee in KNEES:
        own = [x for x in outcomes.values() if x["knee"] == knee]
        values = [x[k] for x in own for k in ("deviance", "inside", "outside") if k in x]
        lowest = float(np.nanmin(values))
        wrong = [(x, fault) for x in own if (fault := _fault(x, lowest))]
        measures.append(
            Measure(
                what=f"{knee}: ends that differ by more than 2 % of the interval",
                value=float(len(wrong)),
                unit="ends",
                bar=MOST_WRONG,
                count=len(own),
            )
        )
        notes += [
            f"{knee}: the profiles' fit is {own[0]['deviance'] - lowest:.2g} above the lowest",
            *(
                f"{knee}: {x['name']} {x['side']} {x['value']:.4g} ({x['status']}): {fault}; rise "
                f"inside {x.get('inside', np.nan) - lowest:.3g}, outside "
                f"{x.get('outside', np.nan) - lowest:.3g}"
                for x, fault in wrong
            ),
        ]
    return Row(
        line="16 ends of profiles of s192803 and of s192803_bundles against fits from 20 starts "
        "with ten times the budget: <= 1 differs in status or by > 2 % of the width",
        measures=measures,
        notes=notes,
    )
