"""Slow part of the study: posteriors of both knees, their predictions, profiles beside them.

Writes ``records/posterior.json`` after each part. Finished work is kept in stores outside the
checkout, so that the same command resumes where it was stopped.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from identknee.calibrate.starts import named_start
from identknee.identify.optimum import best_fit
from identknee.identify.posterior.convergence import StopRule
from identknee.identify.posterior.nested import nested_posterior, quantile_differences
from identknee.identify.posterior.posterior import Posterior
from identknee.identify.posterior.power_scaling import prior_sensitivity
from identknee.identify.posterior.sample import sample
from identknee.identify.profile.profiles import profile_parameters
from identknee.laxity.noise import add_noise
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.model.tensions import tensions_of
from identknee.report.sample_groups import predictive_groups, sample_summary
from identknee.report.study_records import (
    knee_digest,
    record_head,
    rounded,
    study_knee,
    write_record,
)
from identknee.runs.arrays import Array
from identknee.runs.executors import Executor, process_pool
from identknee.runs.resume import open_work
from identknee.runs.store import Store
from identknee.subject.knee import Knee

HERE = Path(__file__).parent
RECORD = HERE / "records" / "posterior.json"
COMMAND = "python studies/05_posterior/compute.py"
KNEES = ("reference", "lenhart2015_stable")
TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.
NOISE_MM, NOISE_DEG = 0.5, 0.5
SEED = 1
N_DRAWS = 400
QUICK = StopRule(drift=np.inf, budget=3000)
# Nested sampling shares nothing with the ensembles; one knee is enough to compare them.
NESTED_KNEE, N_LIVE, QUICK_LIVE = "reference", 300, 20
FORCE_QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
DIGITS = 5
Row = dict[str, Any]


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = parsed_options()
    knees = {name: study_knee(name) for name in KNEES}
    if options.quick:
        knees = {"reference": knees["reference"]}
    record: Row = {
        "head": record_head(
            COMMAND + (" --quick" if options.quick else ""),
            settings={
                "noise_mm": NOISE_MM,
                "noise_deg": NOISE_DEG,
                "seed": SEED,
                "truth": TRUTH,
                "workers": options.workers,
            },
            inputs={name: knee_digest(knee) for name, knee in knees.items()},
        ),
        "knees": {},
    }
    with process_pool(options.workers) as executor:
        for name, knee in knees.items():
            record["knees"][name] = {}
            for row in parts(name, knee, options, executor):
                record["knees"][name].update(rounded(row, DIGITS))
                write_record(options.record, record)
    say(f"written: {options.record.name}")


def parsed_options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    store = platformdirs.user_cache_path("identknee") / "studies" / "posterior"
    parser.add_argument("--store", type=Path, default=store, help="folder of finished work")
    parser.add_argument("--record", type=Path, default=RECORD, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="a short sample of one knee")
    return parser.parse_args()


def parts(name: str, knee: Knee, options: argparse.Namespace, executor: Executor) -> Iterator[Row]:
    """Parts of the record of one knee, as they are done."""
    problem = problem_of(knee)
    model = problem.model
    truth = named_start(TRUTH, model.parameters)
    about = {"knee": knee_digest(knee), "truth": truth, "noise": [NOISE_MM, NOISE_DEG]}
    rule = QUICK if options.quick else StopRule()
    began = time.perf_counter()
    with open_work(options.store / f"{name}.sqlite", {**about, "seed": SEED}) as store:
        found = sample(problem, rule=rule, seed=SEED, executor=executor, store=store)
        say(f"{name}: {found.outcome.value}, {time.perf_counter() - began:.0f} s")
        yield {
            "parameters": model.parameters.names,
            "truth": truth,
            "sample": {**sample_summary(found), "seconds": time.perf_counter() - began},
            "tau": {"kept": [x.kept for x in found.checks], "tau": [x.tau for x in found.checks]},
            **draws(found),
        }
        yield {"predictions": predictions(found, model, problem, truth)}
        sensitivity = prior_sensitivity(found)
        yield {
            "leaning": {
                "prior": sensitivity.prior,
                "likelihood": sensitivity.likelihood,
                "verdicts": sensitivity.verdicts,
            }
        }
        yield {"profiles": intervals(problem, executor, store)}
    if name == NESTED_KNEE:
        yield {"nested": second_opinion(found, problem, quick=options.quick)}


def problem_of(knee: Knee) -> LaxityResiduals:
    """The 63 trials simulated at the true parameters with noise, in units of that noise."""
    model = LaxityModel(knee=knee, protocol=load_protocol("seed63"))
    truth = named_start(TRUTH, model.parameters)
    laxity = add_noise(model.simulate(truth), sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=SEED)
    return LaxityResiduals(model=model, laxity=laxity, weighting="noise")


def intervals(problem: LaxityResiduals, executor: Executor, store: Store | None = None) -> Row:
    """Both ends and the verdict of every parameter's profile."""
    best = best_fit(problem, seed=SEED, executor=executor)
    profiles = profile_parameters(problem, best.theta, executor=executor, store=store)
    return {
        x.name: {"lower": x.lower, "upper": x.upper, "verdict": x.verdict.value} for x in profiles
    }


def draws(found: Posterior) -> Row:
    """Draws as good as independent, and of the prior."""
    places = found.independent(N_DRAWS, or_fewer=True)
    return {"draws": found.kept[tuple(places.T)], "prior": found.prior}


def predictions(
    found: Posterior, model: LaxityModel, problem: LaxityResiduals, truth: Array
) -> Row:
    """Forces in the trials of the highest load, and how well laxity is known."""
    data = predictive_groups(found, model, problem.laxity, n_draws=N_DRAWS)["posterior_predictive"]
    forces = data["tension_N"].to_numpy()[0]
    laxity = data["coordinates"].to_numpy()[0]
    true = model.predict(truth, derivatives=False)
    loads = np.abs(model.protocol.loads)
    chosen = np.flatnonzero(((loads == loads.max(axis=0)) & (loads > 0.0)).any(axis=1))
    half_widths = 0.5 * np.diff(np.quantile(laxity, [0.025, 0.975], axis=0), axis=0)[0]
    force_widths = 0.5 * np.diff(np.quantile(forces, [0.025, 0.975], axis=0), axis=0)[0]
    tensions = tensions_of(model, true)
    low, high = np.quantile(forces, [0.025, 0.975], axis=0)
    return {
        "ligaments": [x.name for x in model.knee.ligaments],
        "trials": [model.protocol.trials[i] for i in chosen],
        "force_quantiles_N": np.quantile(forces[:, chosen], FORCE_QUANTILES, axis=0).transpose(
            1, 2, 0
        ),
        "true_force_N": tensions[chosen],
        "largest_force_half_width_N": force_widths.max(axis=0),
        "share_of_forces_inside": np.mean((tensions >= low) & (tensions <= high), axis=0),
        "largest_laxity_half_width": {
            "mm": half_widths[:, TRANSLATIONS].max(),
            "deg": half_widths[:, ROTATIONS].max(),
        },
        "coordinates": COORDINATES,
    }


def second_opinion(found: Posterior, problem: LaxityResiduals, *, quick: bool) -> Row:
    """Nested sampling of the same posterior."""
    began = time.perf_counter()
    nested = nested_posterior(problem, n_live=QUICK_LIVE if quick else N_LIVE, seed=SEED)
    say(f"nested sampling: {time.perf_counter() - began:.0f} s")
    return {
        "log_evidence": nested.log_evidence,
        "log_evidence_error": nested.log_evidence_error,
        "n_simulations": nested.n_simulations,
        "effective_draws": nested.effective_draws,
        "quantile_differences": quantile_differences(found, nested),
        "seconds": time.perf_counter() - began,
    }


def say(text: str) -> None:
    """Tell how far it is."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


if __name__ == "__main__":
    main()
