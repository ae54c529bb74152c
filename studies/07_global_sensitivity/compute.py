"""Slow part of the study: global sensitivity of laxity over a box and over a posterior.

Writes ``records/global_sensitivity.json``. Finished simulations are kept in stores outside the
checkout, so that the same command resumes where it was stopped.
"""

import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.problems import model_of, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.identify.sensitivity import Method, sensitivity
from identknee.laxity.trial_words import laxity_groups

# Blocks, trajectories, draws: in full on the reference knee, a fifth or so on the real one.
KNEES = {
    "reference": {"sobol": 4096, "morris": 512, "draws": 1000},
    "lenhart2015_stable": {"sobol": 1024, "morris": 128, "draws": 500},
}
QUICK = {"sobol": 32, "morris": 8, "draws": 300}
OVER_BOX: tuple[Method, ...] = ("sobol", "morris")
OVER_POSTERIOR: tuple[Method, ...] = ("delta", "pawn", "hdmr", "shapley")
NOISE_MM, NOISE_DEG = 0.5, 0.5
SEED = 7
DIGITS = 4


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = records.parsed_options(__file__, "few simulations of one knee")
    knees = {name: study_knee(name) for name in KNEES}
    if options.quick:
        knees = {"reference": knees["reference"]}
    numbers = {name: QUICK if options.quick else KNEES[name] for name in knees}
    record = records.begun(
        options, knees, numbers=numbers, noise_mm=NOISE_MM, noise_deg=NOISE_DEG, seed=SEED
    )
    with ik.runs.process_pool(options.workers) as executor:
        for name, knee in knees.items():
            record["knees"][name] = {}
            for row in analysed(knee, numbers[name], options.store, executor):
                record["knees"][name].update(row)
                write_record(options.record, record)
    records.say(f"written: {options.record.name}")


def analysed(
    knee: ik.Knee, numbers: dict[str, int], folder: Path, executor: ik.runs.Executor
) -> Any:
    """Parts of the record of one knee, as they are done."""
    outputs = outputs_of(knee)
    model, truth = outputs.model, outputs.free.fixed_values
    box = ik.identify.box_around(model.parameters, truth)
    yield {
        "parameters": list(model.parameters.names),
        "box": rounded({"lower": box.lower, "upper": box.upper}),
    }
    draws = posterior_draws(model, truth, numbers["draws"])
    yield {"posterior": posterior_row(draws)}
    about = {"knee": records.knee_digest(knee), "truth": truth, "seed": SEED}
    for method in (*OVER_BOX, *OVER_POSTERIOR):
        over: ik.identify.Box | ik.runs.Array = box if method in OVER_BOX else draws
        began = time.perf_counter()
        with ik.runs.open_work(
            folder / f"{knee.name}_{kind(over)}.sqlite", work(about, over)
        ) as store:
            n = numbers.get(method)
            found = sensitivity(
                outputs, over, method=method, n_samples=n, seed=SEED, executor=executor, store=store
            )
        records.say(f"{knee.name} {method}: {time.perf_counter() - began:.0f} s")
        yield {method: row_of(found, time.perf_counter() - began)}


def outputs_of(knee: ik.Knee) -> ik.model.LaxityOutputs:
    """All coordinates of the 63 trials in their groups, as functions of every parameter."""
    model = model_of(knee)
    return ik.model.LaxityOutputs(
        model=model,
        groups=tuple(x.name for x in laxity_groups(model.protocol)),
        free=model.parameters.with_fixed((), truth_of(model.parameters)),
    )


def kind(over: ik.identify.Box | ik.runs.Array) -> str:
    """What to call the place analysed."""
    return "box" if isinstance(over, ik.identify.Box) else "posterior"


def work(about: Row, over: ik.identify.Box | ik.runs.Array) -> Row:
    """What the finished simulations of a store depend on."""
    if isinstance(over, ik.identify.Box):
        return {**about, "lower": over.lower, "upper": over.upper}
    return {**about, "draws": ik.runs.digest(np.ascontiguousarray(over).tobytes())}


def posterior_draws(model: ik.LaxityModel, truth: ik.runs.Array, n: int) -> ik.runs.Array:
    """Draws from the Gaussian approximation to the posterior of noisy data, shape ``(n, p)``.

    It is centred at the point of highest density, has the inverse of the information there, data
    and prior, as its covariance, and is cut off at the bounds.
    """
    laxity = ik.add_noise(model.simulate(truth), sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=SEED)
    residuals = ik.LaxityResiduals(model=model, laxity=laxity, weighting="noise")
    problem = ik.calibrate.ProblemWithPriors(problem=residuals)
    best = fit(problem, truth).theta
    problem.residuals(best)
    jacobian = problem.jacobian(best)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    generator = np.random.default_rng(SEED)
    draws = np.empty((0, model.parameters.n))
    while len(draws) < n:
        more = generator.multivariate_normal(best, covariance, n)
        inside = (more >= model.parameters.lower) & (more <= model.parameters.upper)
        draws = np.vstack([draws, more[inside.all(axis=1)]])
    return draws[:n]


def posterior_row(draws: ik.runs.Array) -> Row:
    """What the draws look like."""
    row: Row = rounded(
        {
            "n": len(draws),
            "mean": draws.mean(axis=0),
            "sd": draws.std(axis=0, ddof=1),
            "correlation": np.corrcoef(draws.T),
        },
        DIGITS,
    )
    return row


def row_of(found: ik.identify.Sensitivity, seconds: float) -> Row:
    """An analysis in the record."""
    last = {
        name: {
            "value": index.final,
            "half_width": index.final_half_widths,
            "complete": index.complete,
            "complete_half_width": index.complete_half_widths,
            "noise_floor": index.noise_floor,
            "largest_half_width_by_level": index.half_widths.max(axis=2),
        }
        for name, index in found.indices.items()
    }
    row: Row = rounded(
        {
            "groups": list(found.groups),
            "n_samples": found.n_samples,
            "n_simulations": found.n_simulations,
            "levels": next(iter(found.indices.values())).levels.tolist(),
            "failed_share": found.failed_share,
            "complete_share": found.complete_share,
            "component_share": found.component_share,
            "largest_half_width": found.largest_half_width,
            "more_simulations": found.more_simulations(),
            "failures": found.rule,
            "indices": last,
            "seconds": seconds,
        },
        DIGITS,
    )
    return row


if __name__ == "__main__":
    main()
