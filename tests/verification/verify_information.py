"""Eigenvalues of the information matrix against automatic high-order differences of predictions."""

import argparse

import numpy as np
from knees import model
from requirement_rows import Row, largest_of

from identknee.calibrate.problem import typical_steps
from identknee.checks.subject_checks import box_sample
from identknee.identify.information import spectrum
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array

BAR = 1e-6
VECTORS = 9
# In typical steps of a parameter, 3 kN or 2 %. Where a contact point comes or goes within a step
# there is a kink, so each residual has the step of its own that is long enough for its rounding
# and short enough for its kinks: where three orders and two neighbouring steps agree best.
STEPS = 10.0 ** -np.arange(2.0, 6.1, 0.5)
ORDERS = {
    4: (2 / 3, -1 / 12),
    6: (3 / 4, -3 / 20, 1 / 60),
    8: (4 / 5, -1 / 5, 4 / 105, -1 / 280),
}


def measure(options: argparse.Namespace) -> Row:
    """Relative error of every eigenvalue, parameters in typical steps, noise 0.5 mm and 0.5 deg."""
    measures, notes = [], []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        around = box_sample(subject.parameters, VECTORS, np.random.default_rng(4))
        errors, largest_condition, skipped = [], 0.0, 0
        for theta in (subject.parameters.center, *around):
            problem = _problem(subject, theta)
            if problem is None:
                skipped += 1
                continue
            scales = typical_steps(subject.parameters)
            exact, _ = spectrum(problem.jacobian(theta) * scales)
            differences, _ = spectrum(_differences(problem, theta, scales))
            errors += (np.abs(differences - exact) / exact).tolist()
            largest_condition = max(largest_condition, float(exact[0] / exact[-1]))
        measures.append(largest_of(name, errors, "relative", bar=BAR))
        notes.append(
            f"{name}: {len(errors)} eigenvalues at {VECTORS + 1 - skipped} parameter vectors, "
            f"condition up to {largest_condition:.3g}; {skipped} vectors have no prediction"
        )
    return Row(
        line="eigenvalues of the information matrix against automatic high-order differences: "
        "1e-6 relative",
        measures=measures,
        notes=notes,
    )


def _problem(of: LaxityModel, theta: Array) -> LaxityResiduals | None:
    laxity = of.simulate(theta)
    if not laxity.is_measured.all():
        return None
    noisy = add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=0)
    return LaxityResiduals(model=of, laxity=noisy, weighting="noise")


def _differences(problem: LaxityResiduals, theta: Array, scales: Array) -> Array:
    """The Jacobian by the parameters in typical steps, from residuals alone."""
    columns = [_column(problem, theta, scales, k) for k in range(theta.size)]
    return np.stack(columns, axis=1)


def _column(problem: LaxityResiduals, theta: Array, scales: Array, k: int) -> Array:
    """Every residual's slope by one parameter, by the step at which estimates agree best."""
    table = np.array([_estimates(problem, theta, k, float(h * scales[k]), h) for h in STEPS])
    best = table[:, -1]
    doubt = np.ptp(table, axis=1)
    neighbour = np.abs(np.diff(best, axis=0))
    doubt[1:] += neighbour
    # A step that leaves the region with a prediction has NaN.
    chosen = np.argmin(np.where(np.isnan(doubt), np.inf, doubt), axis=0)
    return np.asarray(best[chosen, np.arange(best.shape[1])])


def _estimates(problem: LaxityResiduals, theta: Array, k: int, step: float, unit: float) -> Array:
    """Central differences of order 4, 6 and 8, by a typical step, shape ``(3, m)``."""

    def residuals(steps: int) -> Array:
        moved = np.array(theta)
        moved[k] += steps * step
        found = problem.residuals(moved)
        return np.where(np.isfinite(found), found, np.nan)

    odd = [residuals(j) - residuals(-j) for j in range(1, 5)]
    weighted = [
        sum(w * part for w, part in zip(weights, odd, strict=False)) for weights in ORDERS.values()
    ]
    return np.array(weighted) / unit
