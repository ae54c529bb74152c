"""Laxity of a knee in OpenSim 4.6, intact and with a ligament removed. identknee is not imported.

python tests/verification/opensim_knee.py --subject FOLDER --cut LCL --out FILE.json
"""

import json
import sys
import tempfile
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import peers
from peer_opensim import DIFFERENCE_STEPS, OpenSimKnee, solve

LARGEST_NM, SIZE_NM = 4, 2


def main() -> None:
    """Solve the trials of each state, and write their poses."""
    parser = peers.benchmark_parser(__doc__, limit_s=90.0)
    parser.add_argument("--cut", default="LCL", help="the ligament to be removed")
    options = parser.parse_args()
    whole = peers.read_subject(options.subject, options.mesh)
    trials = [peers.Trial(0.0, 0.0, 0.0, after=None), *peers.rays(0.0, LARGEST_NM, 0)]
    found, start, version = {}, np.zeros(5), ""
    for state, gone in (("intact", ""), (f"cut: {options.cut}", options.cut)):
        with tempfile.TemporaryDirectory() as folder:
            knee = OpenSimKnee(without(whole, gone), Path(folder))
            solutions = peers.run_trials(
                trials, partial(solve, knee), partial(beginning, start), options.limit
            )
            start = np.array(solutions[0].pose) * peers.SCALE
            start[:2] = np.radians(solutions[0].pose[:2]) * peers.MM_PER_RADIAN
            found[state] = [
                asdict(x) | {"least_stiffness": least_stiffness(knee, x)} for x in solutions
            ]
            version = knee.opensim.GetVersion()
    options.out.write_text(json.dumps({"version": version, "states": found}) + "\n", "utf-8")


def beginning(start: np.ndarray, trial: peers.Trial) -> np.ndarray:
    """Where a trial that comes after no other begins."""
    del trial
    return start.copy()


def without(subject: peers.Subject, ligament: str) -> peers.Subject:
    """The subject with one ligament removed."""
    kept = [i for i, name in enumerate(subject.ligaments) if name != ligament]
    return replace(
        subject,
        ligaments=tuple(subject.ligaments[i] for i in kept),
        **{x: getattr(subject, x)[kept] for x in ("femoral", "tibial", "stiffness", "strain")},
    )


def least_stiffness(knee: OpenSimKnee, solution: peers.Solution) -> float:
    """The smallest eigenvalue of the stiffness [N/mm]: a stable pose has a positive one."""
    trial, x = solution.trial, np.array(solution.pose)
    x[:2] = np.radians(x[:2]) * peers.MM_PER_RADIAN
    step = DIFFERENCE_STEPS[1]
    columns = [
        knee.residual(trial.flexion_deg, trial.load, x + step * e)
        - knee.residual(trial.flexion_deg, trial.load, x - step * e)
        for e in np.eye(5)
    ]
    stiffness = np.stack(columns, axis=1) / (2.0 * step)
    return float(np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T)).min())


if __name__ == "__main__":
    main()
