"""Trials that are planned for `design`, before there are data."""

import re
from dataclasses import replace

import numpy as np
from small_knee import as_read, small_knee, small_protocol

import identknee as ik
from identknee.laxity.protocol import concatenate
from identknee.verbs.design import lost_plan_sentence

FAR, TARGET = "pulled far", "front.reference_strain_pct"


def test_planned_trials_without_equilibrium_are_named() -> None:
    planned, knee = small_protocol(), small_knee()
    loads = np.zeros((1, planned.loads.shape[1]))
    loads[0, 2] = 900.0
    far = replace(planned.select([0]), name="far", trials=(FAR,), loads=loads)
    names = ik.LaxityModel(knee=knee, protocol=planned).parameters.names
    answer = ik.design(
        knee,
        protocol=concatenate([planned, far], name="plan"),
        noise="0.5mm,0.5deg",
        n_trials=1,
        targets=[TARGET],
        fixed=[x for x in names if x != TARGET],
        candidates=planned.select([3, 4]),
        cost="cut=never,force=never,contact=never",
    )
    assert FAR not in answer.trials_used
    assert [(FAR in x, "others" in x) for x in answer.assumptions if "planned" in x] == [
        (True, True)
    ]


def test_nothing_is_said_of_a_plan_that_holds() -> None:
    whole = as_read()
    assert lost_plan_sentence(whole) == ()
    blank = np.array(whole.coordinates)
    blank[[0, 2]] = np.nan
    (sentence,) = lost_plan_sentence(replace(whole, coordinates=blank, sd=None))
    trials = whole.protocol.trials
    assert [x for x in trials if re.search(rf"\b{x}\b", sentence)] == [trials[0], trials[2]]
