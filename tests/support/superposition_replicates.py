"""How far the deviance rises to the truth where in-situ forces were measured by superposition."""

from dataclasses import replace
from typing import Any

import numpy as np
from experiment_replicates import drawn_truth, rises_to_truth
from replayed_paths import in_situ_forces

import identknee as ik
from identknee.laxity.experiment_tables import joined
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import WRENCH
from identknee.model.laxity_model import LaxityModel
from identknee.verbs.identification import identification

NOISE, EVERY, REPLAYED = 0.5, 6, 3
POSE_SD = (0.1, 0.1)
CELL = {"load_cell_N": 3.0, "load_cell_Nm": 0.1}


def superposition_replicate(seed: int) -> dict[str, Any]:
    """The rise of the profile deviance to each true ligament parameter of the reference knee.

    Of every third trial the path is replayed without the ACL, then without the MCL too; the cell
    has a constant error, each run an error of its pose.
    """
    generator = np.random.default_rng(seed)
    trials = ik.load_protocol("seed63")
    trials = trials.select(range(0, trials.n, EVERY))
    empty = ik.Laxity(protocol=trials, coordinates=np.full((trials.n, 5), np.nan))
    rig = Experiment(name="intact", rig="robot", mounting="robot-1", uncertainty=CELL)
    protocol = joined([(rig, empty)]).protocol
    knee = ik.reference_knee()
    model = LaxityModel(knee=knee, protocol=protocol)
    theta, found = drawn_truth(model, generator, protocol.n)
    rows = [
        (trial, *x)
        for trial in protocol.trials[::REPLAYED]
        for x in (("ACL", "intact", "cut: ACL"), ("MCL", "cut: ACL", "cut: ACL, MCL"))
    ]
    made = in_situ_forces(model, theta, rows, pose_sd=POSE_SD, generator=generator)
    offsets = [theta[model.parameters.index(f"robot/load_cell.{x}")] for x in WRENCH]
    noise = generator.normal(scale=NOISE, size=found.coordinates.shape)
    laxity = ik.Laxity(
        protocol=protocol,
        coordinates=found.coordinates + noise,
        sd=np.full(noise.shape, NOISE),
        superposition=replace(made, values=made.values + np.array([*offsets, 0.0])),
    )
    truth = dict(zip(model.parameters.names, theta.tolist(), strict=True))
    return rises_to_truth(identification(knee, laxity), truth)
