"""Slow part of the study: a measured knee fitted with and without what is known of every knee.

Writes ``records/believable_knee.json`` after each part. Finished work is kept in a store outside
the checkout, so that the same command resumes where it was stopped.
"""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.records import (
    Row,
    begun,
    begun_again,
    parsed_options,
    rounded,
    say,
    working,
    write_record,
)
from predictions import (
    JUDGED,
    FittedModel,
    Value,
    changes,
    predicted,
    second_device,
    values,
)

import identknee as ik
from identknee.calibrate.problem import evidence_terms, misfit_square
from identknee.checks.fit_checks import implausible_findings
from identknee.checks.usable_trials import TrialSearch, table_model
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.protocol import LOADS, dominant_loads
from identknee.model.candidate_laxity import CONTACT_SD, TENSION_SD
from identknee.model.contact_loads import COMPARTMENTS, contact_values
from identknee.model.discrepancy import SmoothDiscrepancy
from identknee.model.line_loads import (
    strains_of,
    structure_names,
    tensions_of,
    values_of_structures,
)
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array
from identknee.runs.executors import serial
from identknee.subject.knee import EffectChoice, with_stated_uncertainty
from identknee.subject.plausibility import CONTACT, OTHER_NAMES, strengths_by_name
from identknee.verbs.fit import split
from identknee.verbs.identification import best_fits, identification, with_noise

KNEES = ("s192803", "s192803_bundles")
LINES, BUNDLES = KNEES
WRONG_ROW = "Valgus_60"
NOISE = "1mm,1.5deg"
UNCERTAIN = "registration=4deg,registration=4mm,insertions=4mm"


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A way to fit the knee."""

    plausible: str = "none"
    uncertain: str = UNCERTAIN
    discrepancy: str = "none"
    structure: str = ""


PLAIN, LIMITS, BONE = "plain", "limits", "limits, on the bone"
ERROR, BOTH = "error of the model", "limits and error of the model"
MENISCI = "meniscus"
WITH_MENISCI, PLAIN_MENISCI = "limits, menisci", "menisci"
# The structures that four lines lack, as nuisances with their priors. Bundles lack none.
UNKNOWN, WITH_UNKNOWN = "structures unknown", "limits, structures unknown"
VARIANTS: Mapping[str, Variant] = {
    PLAIN: Variant(),
    LIMITS: Variant(plausible="default"),
    BONE: Variant(plausible="default", uncertain=f"{UNCERTAIN},insertions_normal=2mm"),
    ERROR: Variant(discrepancy="smooth"),
    BOTH: Variant(plausible="default", discrepancy="smooth"),
    WITH_MENISCI: Variant(plausible="default", structure=MENISCI),
    PLAIN_MENISCI: Variant(structure=MENISCI),
    UNKNOWN: Variant(uncertain=f"{UNCERTAIN},structures=100%"),
    WITH_UNKNOWN: Variant(plausible="default", uncertain=f"{UNCERTAIN},structures=100%"),
}
FITTED = (PLAIN, LIMITS, BONE, ERROR, BOTH)
# Sheets of the capsule are parts of the knee, all others effects whose amplitudes are fitted.
CAPSULE = "capsule"
STRUCTURES: Mapping[str, tuple[str, ...]] = {
    LINES: (MENISCI, "mcl_wrapping", CAPSULE),
    BUNDLES: (MENISCI,),
}
# Trials held out: the first are all but anterior, posterior, varus and valgus at 0 and 90 deg.
FIRST_SPLIT = "loads and angles"
SPLITS: Mapping[str, tuple[str, ...]] = {
    FIRST_SPLIT: ("*_30", "*_60", "Internal*", "External*", "FullExt*"),
    "0 deg": ("*_0",),
}
Fits = Mapping[tuple[str, str], tuple[str, ...]]
PREDICTING: Fits = {
    (LINES, PLAIN): tuple(SPLITS),
    (LINES, LIMITS): tuple(SPLITS),
    (LINES, WITH_MENISCI): tuple(SPLITS),
    (LINES, BOTH): tuple(SPLITS),
    (BUNDLES, PLAIN): (FIRST_SPLIT,),
    (BUNDLES, LIMITS): (FIRST_SPLIT,),
}
LAST_PREDICTING: Fits = {(BUNDLES, PLAIN): ("0 deg",), (BUNDLES, LIMITS): ("0 deg",)}
PREDICTING_UNKNOWN: Fits = {(LINES, x): tuple(SPLITS) for x in (UNKNOWN, WITH_UNKNOWN)}
PROFILED = (PLAIN, LIMITS)
FITS_UNKNOWN, PROFILES_UNKNOWN, HELD_OUT_UNKNOWN = ALONE = (
    "structures_unknown",
    "profiles_with_structures_unknown",
    "held_out_with_structures_unknown",
)
# A single measurement beside the table: what, and in which of its trials. The values are those of
# the believable knee of four lines.
MEASUREMENTS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("contact.medial_N", "contact.lateral_N"), "Anterior_30"),
    (("MCL.tension_N",), "Valgus_30"),
    (("LCL.tension_N",), "Varus_30"),
)
DIGITS = 6


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options(__file__, parts=ALONE)
    record = begun(options, KNEES, noise=NOISE, uncertain=UNCERTAIN, splits=SPLITS)
    record["knees"] = {x: {} for x in KNEES}
    if options.part:
        record = begun_again(options, record)
    began = time.perf_counter()
    with working(options, inputs=record["head"]["inputs"]) as kept:

        def done(part: str, work: Callable[[Row], Row], tasks: list[Row]) -> None:
            if options.part and part not in options.part:
                return
            rows = kept(work, tasks, part)
            for knee in KNEES:
                record["knees"][knee][part] = [x for x in rows if x["knee"] == knee]
            record["seconds_last_run"] = rounded(time.perf_counter() - began, 3)
            write_record(options.record, record)
            say(f"written: {options.record.name}, {part}")

        done("fits", fitted, [{"knee": k, "variant": x} for k in KNEES for x in FITTED])
        of_limits = {
            k: next(x for x in record["knees"][k]["fits"] if x["variant"] == LIMITS) for k in KNEES
        }
        done(
            "structures",
            extended,
            [
                {"knee": k, "structure": x, "start": of_limits[k]["theta"]}
                for k in KNEES
                for x in STRUCTURES[k]
            ],
        )
        of_menisci = {
            k: next(x for x in record["knees"][k]["structures"] if x["structure"] == MENISCI)
            for k in KNEES
        }
        done(
            "second_device",
            on_second_device,
            [{"knee": k, "variant": WITH_MENISCI, "at": of_menisci[k]["theta"]} for k in KNEES],
        )
        done("without_limits", lowest_fit, [{"knee": k, "variant": PLAIN_MENISCI} for k in KNEES])
        done("held_out", held_out, held_out_tasks(PREDICTING))
        believable = of_limits[LINES]
        done(
            "measurements",
            measured_once,
            [
                {
                    "knee": LINES,
                    "trial": trial,
                    "forces": {x: force_at(believable, x, trial) for x in quantities},
                }
                for quantities, trial in MEASUREMENTS
            ],
        )
        done("profiles", profiled, [{"knee": LINES, "variant": x} for x in PROFILED])
        done("held_out_at_0_deg", held_out, held_out_tasks(LAST_PREDICTING))
        unknown = [{"knee": LINES, "variant": x} for x in (UNKNOWN, WITH_UNKNOWN)]
        done(FITS_UNKNOWN, fitted, unknown)
        done(PROFILES_UNKNOWN, profiled, unknown[1:])
        done(HELD_OUT_UNKNOWN, held_out, held_out_tasks(PREDICTING_UNKNOWN))


def held_out_tasks(fits: Fits) -> list[Row]:
    """A task for each model, fit and split."""
    return [
        {"knee": knee, "split": split, "variant": variant}
        for (knee, variant), splits in fits.items()
        for split in splits
    ]


def table(*, with_held_out: bool = True) -> ik.Laxity:
    """The measured laxity with its noise; the cells of the row that cannot be right are blank."""
    laxity = ik.example_laxity("s192803")
    coordinates = np.array(laxity.coordinates)
    coordinates[laxity.protocol.trials.index(WRONG_ROW)] = np.nan
    laxity = replace(laxity, coordinates=coordinates)
    if not with_held_out:
        laxity = laxity.select(np.flatnonzero(laxity.is_measured.any(axis=1)))
    return with_noise(laxity, NOISE)


def knee_of(name: str, variant: Variant, structure: str = "") -> ik.Knee:
    """The subject as a variant takes it, with one structure more if asked."""
    knee, structure = ik.example(name), structure or variant.structure
    if structure == CAPSULE:
        knee = ik.subject.with_capsule(knee)
    elif structure:
        knee = knee.with_effects([EffectChoice(name=structure)])
    stated = with_stated_uncertainty(knee.uncertainty, variant.uncertain)
    return knee.with_uncertainty(stated).with_plausibility(variant.plausible)


def fitted(task: Row) -> Row:
    """A fit to all trials but the wrong row, and what it predicts of the other device."""
    began = time.process_time()
    variant = VARIANTS[task["variant"]]
    knee, laxity = knee_of(task["knee"], variant), table()
    if variant.discrepancy == "none":
        found = ik.fit(knee, laxity, **settings(variant))
        end = ended(knee, laxity, found.search.theta)
        row = {**described(end), **how(found)}
    else:
        end = lowest(knee, laxity, discrepancy=variant.discrepancy)
        row = described(end)
    row["second_device"] = device_changes(end)
    return {**task, **row, "seconds": rounded(time.process_time() - began, 3)}


def device_changes(end: FittedModel) -> list[Value]:
    """What a fit predicts of the other device, beside what was measured there."""
    other = second_device()
    made: list[Value] = rounded(changes(predicted(end, other.protocol), other), DIGITS)
    return made


def on_second_device(task: Row) -> Row:
    """The same of a fit whose parameters are known."""
    knee = knee_of(task["knee"], VARIANTS[task["variant"]])
    end = ended(knee, table(), np.array(list(task["at"].values())))
    named = {"knee": task["knee"], "variant": task["variant"]}
    return {**named, "second_device": device_changes(end)}


def extended(task: Row) -> Row:
    """The lowest fit with limits and one structure more, begun at that without the structure."""
    began = time.process_time()
    knee = knee_of(task["knee"], VARIANTS[LIMITS], task["structure"])
    row = described(lowest(knee, table(), start=task["start"]))
    named = {"knee": task["knee"], "structure": task["structure"]}
    return {**named, **row, "seconds": rounded(time.process_time() - began, 3)}


def lowest_fit(task: Row) -> Row:
    """The lowest fit of a variant, without its price."""
    began = time.process_time()
    row = described(lowest(knee_of(task["knee"], VARIANTS[task["variant"]]), table()))
    return {**task, **row, "seconds": rounded(time.process_time() - began, 3)}


def held_out(task: Row) -> Row:
    """A fit without some trials, and its prediction of these."""
    began = time.process_time()
    variant, laxity = VARIANTS[task["variant"]], table(with_held_out=False)
    seen, is_held = split(laxity, SPLITS[task["split"]])
    kept = laxity.select(is_held)
    end = lowest(knee_of(task["knee"], variant), seen, discrepancy=variant.discrepancy)
    found = predicted(end, kept.protocol)
    made = values(found, kept)
    row = {
        "n_trials": int(is_held.sum()),
        "degrees_of_freedom": found.degrees_of_freedom,
        "chi_square": misfit_square(end.problem, end.theta),
        "rmse": rmse_of(end),
        "values": made,
        "judged": [x for x in made if JUDGED.get(str(x[0]).split("_")[0]) == x[1]],
        "seconds": time.process_time() - began,
    }
    return {**task, **rounded(row, DIGITS)}


def profiled(task: Row) -> Row:
    """The interval of every parameter, and what makes its ends."""
    began = time.process_time()
    variant = VARIANTS[task["variant"]]
    found = ik.profile(
        knee_of(task["knee"], variant),
        table(),
        discrepancy=variant.discrepancy,
        priors=False,
        **settings(variant),
    )
    row = {
        "deviance": found.deviance,
        "conditional_on_misfit": found.conditional_on_misfit,
        "parameters": {
            name: {
                "best": found.optimum_by_name[name],
                "ends": [x.lower, x.upper],
                "made_by": [x.lower_side.origin, x.upper_side.origin],
                "status": [x.lower_side.status.value, x.upper_side.status.value],
                "verdict": x.verdict.value,
            }
            for name, x in found.parameters.items()
        },
        "seconds": time.process_time() - began,
    }
    return {**task, **rounded(row, DIGITS)}


def force_at(row: Row, quantity: str, trial: str) -> float:
    """A force of a fit in one trial."""
    place = row["trials"].index(trial)
    owner, _, kind = quantity.partition(".")
    if owner == CONTACT:
        return float(row["contact_N"][place][COMPARTMENTS.index(kind.removesuffix("_N"))])
    return float(row["forces_N"][owner][place])


def measured_once(task: Row) -> Row:
    """A fit without limits to the table and the forces of one trial."""
    began = time.process_time()
    variant, laxity = VARIANTS[PLAIN], table()
    knee = knee_of(task["knee"], variant)
    names = tuple(task["forces"])
    found = np.full((laxity.n, len(names)), np.nan)
    found[laxity.protocol.trials.index(task["trial"])] = list(task["forces"].values())
    sizes = [CONTACT_SD if x.startswith(CONTACT) else TENSION_SD for x in names]
    sd = np.where(np.isfinite(found), sizes, np.nan)
    laxity = replace(laxity, forces=MeasuredForces(names=names, values=found, sd=sd))
    fit = ik.fit(knee, laxity, **settings(variant))
    row = {**described(ended(knee, laxity, fit.search.theta)), **how(fit)}
    return {**task, **row, "seconds": rounded(time.process_time() - began, 3)}


def settings(variant: Variant) -> dict[str, Any]:
    """What a verb is asked for."""
    return {
        "noise": NOISE,
        "uncertain": variant.uncertain,
        "plausible": variant.plausible,
    }


def ended(
    knee: ik.Knee, laxity: ik.Laxity, theta: Array, error: SmoothDiscrepancy | None = None
) -> FittedModel:
    """The model of the data where a fit ended."""
    model, _ = table_model(knee, laxity)
    trials = TrialSearch(model=model, laxity=laxity, weighting="noise", bounds={})
    return FittedModel(
        model=model, laxity=laxity, theta=theta, problem=trials.problem(laxity), error=error
    )


def lowest(
    knee: ik.Knee,
    laxity: ik.Laxity,
    *,
    discrepancy: str = "none",
    start: Mapping[str, float] | str = "subject",
) -> FittedModel:
    """The lowest end of the searches that all verbs make, without the price of limits.

    It averages over a smooth error of the model if asked.
    """
    setup = identification(knee, laxity, discrepancy=discrepancy, start=start)
    fits = best_fits(setup, seed=0, executor=serial)
    return FittedModel(
        model=setup.model,
        laxity=setup.laxity,
        theta=setup.free.expand(fits[0].theta),
        problem=setup.problem,
        error=setup.discrepancy,
    )


def described(end: FittedModel) -> Row:
    """What a fit is, as far as its parameters say: they alone are kept to all digits."""
    parameters = end.problem.parameters
    row: Row = {
        "n_parameters": int(parameters.is_of_interest.sum()),
        "n_nuisances": len(parameters.nuisance_names),
        **at_fit(end),
    }
    if end.error is not None:
        row["error"] = {
            "sd": end.error.sd,
            "lengths": [end.error.flexion_length, end.error.load_length],
            "chi_square": misfit_square(end.problem, end.theta),
        }
    theta = dict(zip(parameters.names, end.theta.tolist(), strict=True))
    return {**rounded(row, DIGITS), "theta": theta}


def at_fit(end: FittedModel) -> Row:
    """Deviance, errors, forces and contact at the parameters of a fit, without any search."""
    plain = ended(end.model.knee, end.laxity, end.theta)
    terms = evidence_terms(plain.problem, end.theta)
    model = plain.model
    prediction = model.predict(end.theta, derivatives=False)
    tension, strain = tensions_of(model, prediction), strains_of(model, prediction)
    names = [x.name for x in model.knee.ligaments]
    strengths = strengths_by_name(model.knee.donor_age)
    groups = {
        name: [k for k, x in enumerate(names) if x.startswith(name)]
        for name in strengths
        if any(x.startswith(name) for x in names)
    }
    contact = contact_values(prediction)[:, :, 0]
    is_straight = dominant_loads(model.protocol).axis != LOADS.index("varus_moment_Nm")
    measured = end.laxity.is_measured.any(axis=1)
    counts = is_straight & prediction.is_converged & measured
    taut = np.where(tension > 0.0, strain, np.nan)
    findings = implausible_findings(model, prediction)
    return {
        "trials": list(model.protocol.trials),
        "n_with_equilibrium": int(prediction.is_converged[measured].sum()),
        "chi_square": misfit_square(plain.problem, end.theta),
        "terms": {x.name: x.deviance for x in terms},
        "rmse": rmse_of(plain),
        "contact_N": contact,
        "mean_contact_N": contact[counts].mean(axis=0),
        "forces_N": {x: tension[:, own].sum(axis=1) for x, own in groups.items()},
        "strengths_N": {x: list(strengths[x][:2]) for x in groups},
        "largest_strain_pct": {
            x: float(np.nanmax(own)) if np.isfinite(own).any() else None
            for x, own in zip(names, taut.T, strict=True)
        },
        "implausible": [{"sentence": x.sentence} for x in findings],
        **added_forces(model, prediction),
    }


def added_forces(model: ik.LaxityModel, prediction: Prediction) -> Row:
    """The force of each structure that the model has beside the ligaments; none without any."""
    names = [x for x in structure_names(model) if x in OTHER_NAMES]
    if not names:
        return {}
    found = values_of_structures(model, prediction, names)[0]
    return {"added_N": dict(zip(names, found.T, strict=True))}


def rmse_of(end: FittedModel) -> Array:
    """Root-mean-square error of each coordinate over the trials measured."""
    off = end.model.predict(end.theta, derivatives=False).coordinates - end.laxity.coordinates
    return np.asarray(np.sqrt(np.nanmean(off**2, axis=0)))


def how(found: ik.Calibration) -> Row:
    """How a fit ended, and what the limits cost."""
    price = found.plausibility
    row: Row = {
        "outcome": found.outcome.value,
        "trials_used": len(found.trials_used),
        "n_as_good": len(found.optima),
    }
    if price is not None:
        row["price"] = {
            "price": price.price,
            "of_data": price.of_data,
            "limits": [
                {
                    "name": x.limit.name,
                    "value": x.limit.value,
                    "deviance": x.limit.deviance,
                    "drop_one": x.drop_one,
                    "alone": x.alone,
                    "value_without": x.value_without,
                }
                for x in price.limits
            ],
        }
    return dict(rounded(row, DIGITS))


if __name__ == "__main__":
    main()
