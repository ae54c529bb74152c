"""Cases for what `diagnose` concludes: torn ligaments, and how far a cause is from all listed."""

from dataclasses import replace
from typing import Any

import numpy as np
from knees import knee

from identknee.blind.case import CORRELATION, SD, BlindCase, contact_stays_inside, rims_of
from identknee.blind.experiment import experiment_of, run_experiment, tensions
from identknee.diagnosis.candidates import library_variants
from identknee.diagnosis.fitting import (
    base_model,
    best_fit_from,
    fitted_with_nuisances,
    stated_noise,
)
from identknee.diagnosis.investigation import investigate
from identknee.diagnosis.score import project_signature
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.library import library
from identknee.subject.knee import Knee

# A torn ligament keeps so much of its stiffness; a slack one has so much less strain [%].
# Without any other ligament, both knees have no equilibrium under any of the loads.
MISSED = "MCL"
TORN_SHARE, SLACK_PCT = 0.002, 25.0
# Of which one is the share of the loads of the 63 trials: not every knee bears all without it.
LOAD_SHARES = (1.0, 0.6, 0.35, 0.2)
# What it may still carry in a trial [N].
MOST_LEFT_N = 5.0
STIFFNESS_LOG_SD, STRAIN_SD_PCT = 0.2, 1.0
LEAST_MOVED, MOST_DRAWS = 5.0, 60


def torn_outcome(subject: str, seed: int) -> dict[str, Any]:
    """The diagnosis of laxity of the separate generator in which a ligament carries nothing.

    Whether it is torn or slack, the loads, and what the others are, the seed says. Draws in which
    it would not be missed, or the knee has no equilibrium without it, are drawn again.
    """
    own, generator = knee(subject), np.random.default_rng(seed)
    for _ in range(MOST_DRAWS):
        found = _torn(own, generator)
        if found is not None:
            break
    else:
        return {"error": "no knee is stable without a ligament", "seed": seed}
    laxity, ligament, kind, moved = found
    noisy = add_noise(
        laxity, sd_mm=SD, sd_deg=SD, seed=int(generator.integers(2**31)), correlation=CORRELATION
    )
    outcome = {"seed": seed, "ligament": ligament, "kind": kind, "moved": moved}
    diagnosed = investigate(own, noisy)
    if diagnosed is None:
        return {**outcome, "verdict": "NOT_TESTABLE", "named": False, "p_value": None}
    idle = [x.where for x in diagnosed.findings if x.code == "ligament-idle"]
    return {
        **outcome,
        "verdict": diagnosed.conclusion.verdict.value,
        "p_value": diagnosed.conclusion.p_value,
        "causes": list(diagnosed.explanation.names),
        "idle": idle,
        "named": ligament in idle,
    }


def _torn(own: Knee, generator: np.random.Generator) -> tuple[Laxity, str, str, float] | None:
    m = len(own.ligaments)
    k = np.array([x.stiffness_kN for x in own.ligaments])
    strain = np.array([x.reference_strain_pct for x in own.ligaments])
    k = k * np.exp(generator.normal(0.0, STIFFNESS_LOG_SD, m))
    strain = strain + generator.normal(0.0, STRAIN_SD_PCT, m)
    which = [x.name for x in own.ligaments].index(MISSED)
    kind = str(generator.choice(["torn", "slack"]))
    less = np.r_[k, strain]
    if kind == "torn":
        less[which] *= TORN_SHARE
    else:
        less[m + which] -= SLACK_PCT
    whole = load_protocol("seed63")
    protocol = replace(whole, loads=float(generator.choice(LOAD_SHARES)) * whole.loads)
    base, runs = experiment_of(own, protocol), []
    for theta in (less, np.r_[k, strain]):
        runs.append(run_experiment(base.with_theta(theta)))
        if not (runs[-1].is_complete and contact_stays_inside(base, runs[-1], rims_of(own))):
            return None
    left = tensions(base.with_theta(less), runs[0], m)[:, which].max()
    moved = float(np.linalg.norm(runs[0].coordinates - runs[1].coordinates)) / SD
    if left > MOST_LEFT_N or moved < LEAST_MOVED:
        return None
    laxity = Laxity(protocol=protocol, coordinates=runs[0].coordinates)
    return laxity, own.ligaments[which].name, kind, moved


def distance_from_listed(subject: str, case: BlindCase, without: str = "") -> tuple[float, str]:
    """How far the data of a case are from the nearest listed effect, in units of noise, and which.

    Without errors, ligaments free, effects straight around the fit without them; `without` is an
    effect that is left out.
    """
    own, exact = knee(subject), case.noise_free
    exact = replace(
        exact,
        sd=np.full(exact.coordinates.shape, SD),
        within_trial_correlation=CORRELATION,
    )
    # The scatter of exact data would say that there is no noise.
    model = base_model(own, exact.protocol).with_tests(exact)
    n, start = model.n_ligament_parameters, np.array(model.parameters.center)
    true = np.r_[[case.truth.theta[x] for x in model.parameters.names[:n]], start[n:]]
    plain = best_fit_from(model, exact, stated_noise(exact), [start, true])
    fitted = fitted_with_nuisances(plain, np.asarray(exact.sd), CORRELATION)
    left = fitted.projector.project(fitted.residual_rows())
    nearest = (float(left @ left), "none")
    listed = library(own, has_order=exact.order is not None, has_phase=exact.phase is not None)
    for variant in library_variants(fitted, [x for x in listed if x.name != without]):
        signature = project_signature(fitted.projector, variant.signature)
        gain = float(signature.gain((left @ signature.projected)[None])[0])
        nearest = min(nearest, (float(left @ left) - gain, variant.effect.name))
    return float(np.sqrt(max(nearest[0], 0.0))), nearest[1]
