"""Slow part of the study: posteriors of both knees, their predictions, profiles beside them.

Writes ``records/posterior.json`` after each part. Finished work is kept in stores outside the
checkout, so that the same command resumes where it was stopped.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.problems import TRUTH, model_of, noisy_problem, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.identify.posterior.sample import sample
from identknee.identify.profile.profile import profile_parameters
from identknee.runs.schema import summary_of
from identknee.verbs.sample import as_answer, predictive

KNEES = ("reference", "lenhart2015_stable")
NOISE = 0.5  # mm and deg
SEED = 1
N_DRAWS = 400
QUICK = ik.identify.StopRule(drift=np.inf, budget=3000)
# Nested sampling shares nothing with the ensembles; one knee is enough to compare them.
NESTED_KNEE, N_LIVE, QUICK_LIVE = "reference", 300, 20
FORCE_QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
DIGITS = 5


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = records.parsed_options(__file__, "a short sample of one knee")
    knees = {name: study_knee(name) for name in KNEES}
    if options.quick:
        knees = {"reference": knees["reference"]}
    record = records.begun(options, knees, noise_mm=NOISE, noise_deg=NOISE, seed=SEED, truth=TRUTH)
    with ik.runs.process_pool(options.workers) as executor:
        for name, knee in knees.items():
            record["knees"][name] = {}
            for row in parts(name, knee, options, executor):
                record["knees"][name].update(rounded(row, DIGITS))
                write_record(options.record, record)
    records.say(f"written: {options.record.name}")


def parts(
    name: str, knee: ik.Knee, options: argparse.Namespace, executor: ik.runs.Executor
) -> Iterator[Row]:
    """Parts of the record of one knee, as they are done."""
    problem = problem_of(knee)
    model = problem.model
    truth = truth_of(model.parameters)
    about = {"knee": records.knee_digest(knee), "truth": truth, "noise": [NOISE, NOISE]}
    rule = QUICK if options.quick else ik.identify.StopRule()
    began = time.perf_counter()
    with ik.runs.open_work(options.store / f"{name}.sqlite", {**about, "seed": SEED}) as store:
        found = sample(problem, rule=rule, seed=SEED, executor=executor, store=store)
        records.say(f"{name}: {found.outcome.value}, {time.perf_counter() - began:.0f} s")
        yield {
            "parameters": model.parameters.names,
            "truth": truth,
            "sample": {**summary_of(as_answer(found)), "seconds": time.perf_counter() - began},
            "tau": {"kept": [x.kept for x in found.checks], "tau": [x.tau for x in found.checks]},
            **draws(found),
        }
        yield {"predictions": predictions(found, model, truth)}
        sensitivity = ik.identify.prior_sensitivity(found)
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


def problem_of(knee: ik.Knee) -> ik.LaxityResiduals:
    """The noisy data of a knee."""
    return noisy_problem(model_of(knee), NOISE, SEED)


def intervals(
    problem: ik.LaxityResiduals, executor: ik.runs.Executor, store: ik.runs.Store | None = None
) -> Row:
    """Both ends and the verdict of every parameter's profile."""
    best = ik.identify.best_fit(problem, seed=SEED, executor=executor)
    profiles = profile_parameters(problem, best.theta, executor=executor, store=store)
    return {
        x.name: {"lower": x.lower, "upper": x.upper, "verdict": x.verdict.value} for x in profiles
    }


def draws(found: ik.identify.Posterior) -> Row:
    """Draws as good as independent, and of the prior."""
    places = found.independent(N_DRAWS)
    return {"draws": found.kept[tuple(places.T)], "prior": found.prior}


def predictions(
    found: ik.identify.Posterior,
    model: ik.LaxityModel,
    truth: ik.runs.Array,
) -> Row:
    """Forces in the trials of the highest load, and how well laxity is known."""
    predicted = predictive(found, model, n_draws=N_DRAWS)
    forces, laxity = predicted.tension_N[0], predicted.coordinates[0]
    true = model.predict(truth, derivatives=False)
    loads = np.abs(model.protocol.loads)
    chosen = np.flatnonzero(((loads == loads.max(axis=0)) & (loads > 0.0)).any(axis=1))
    half_widths = 0.5 * np.diff(np.quantile(laxity, [0.025, 0.975], axis=0), axis=0)[0]
    force_widths = 0.5 * np.diff(np.quantile(forces, [0.025, 0.975], axis=0), axis=0)[0]
    tensions = ik.model.tensions_of(model, true)
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
            "mm": half_widths[:, ik.laxity.TRANSLATIONS].max(),
            "deg": half_widths[:, ik.laxity.ROTATIONS].max(),
        },
        "coordinates": ik.laxity.COORDINATES,
    }


def second_opinion(
    found: ik.identify.Posterior, problem: ik.LaxityResiduals, *, quick: bool
) -> Row:
    """Nested sampling of the same posterior."""
    began = time.perf_counter()
    nested = ik.identify.nested_posterior(
        problem, n_live=QUICK_LIVE if quick else N_LIVE, seed=SEED
    )
    records.say(f"nested sampling: {time.perf_counter() - began:.0f} s")
    return {
        "log_evidence": nested.log_evidence,
        "log_evidence_error": nested.log_evidence_error,
        "n_simulations": nested.n_simulations,
        "effective_draws": nested.effective_draws,
        "quantile_differences": ik.identify.quantile_differences(found, nested),
        "seconds": time.perf_counter() - began,
    }


if __name__ == "__main__":
    main()
