"""A few seconds of known work on the reference knee."""

import time
from collections.abc import Iterator
from importlib.resources import as_file, files

from identknee.calibrate.fit import fit
from identknee.calibrate.starts import load_start
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, read_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.progress import progress_bar
from identknee.subject.reference import reference_knee

# Numbers of the same program on another machine: rounding may differ, nothing else.
SAME_MM_OR_DEG = 1e-6
# Half the step of a central difference [kN and %], and what it can be trusted to, as a share of
# the largest derivative.
STEP, SAME_SLOPE = 1e-3, 1e-4
# Where least squares stops on data without noise.
SAME_KN_OR_PCT = 1e-6


def self_tests() -> Iterator[tuple[str, bool, str]]:
    """Name of each test, whether it passed, and what it found."""
    with progress_bar("preparing, longer the first time after an installation"):
        with as_file(files("identknee.verbs").joinpath("self_test.csv")) as path:
            stored = read_laxity(path)
        model = LaxityModel(knee=reference_knee(), protocol=stored.protocol)
        model.predict(model.parameters.center)
    for name, test in (("poses", _poses), ("derivatives", _derivatives), ("fit", _fit)):
        began = time.perf_counter()
        is_sound, found = test(model, stored)
        yield name, is_sound, f"{found} ({time.perf_counter() - began:.2f} s)"


def _poses(model: LaxityModel, stored: Laxity) -> tuple[bool, str]:
    difference = abs(model.simulate(model.parameters.center).coordinates - stored.coordinates)
    largest = float(difference.max())
    found = f"{stored.n} trials of the reference knee are {largest:.1g} mm or deg from those stored"
    return largest <= SAME_MM_OR_DEG, found


def _derivatives(model: LaxityModel, stored: Laxity) -> tuple[bool, str]:
    residuals = LaxityResiduals(model=model, laxity=stored)
    theta = model.parameters.center
    exact = residuals.jacobian(theta)
    differences = exact * 0.0
    for i in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[i] += STEP
        down[i] -= STEP
        differences[:, i] = (residuals.residuals(up) - residuals.residuals(down)) / (2.0 * STEP)
    share = float(abs(exact - differences).max() / abs(exact).max())
    found = f"exact ones are {share:.1g} of the largest from central differences"
    return share <= SAME_SLOPE, found


def _fit(model: LaxityModel, _: Laxity) -> tuple[bool, str]:
    full = model.with_protocol(load_protocol("seed63"))
    truth = full.parameters.center
    problem = LaxityResiduals(model=full, laxity=full.simulate(truth))
    ended = fit(problem, load_start("IG2", full.parameters))
    largest = float(abs(ended.theta - truth).max())
    found = f"from IG2 it ends {largest:.1g} kN or % from the parameters of its data"
    return largest <= SAME_KN_OR_PCT, found
