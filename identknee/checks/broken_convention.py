"""Which broken convention explains why a model does not fit a table."""

import numpy as np
from scipy.special import chdtrc

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals
from identknee.checks.conventions import Convention, conventions_of
from identknee.checks.table_checks import (
    GROSS,
    IMPROBABLE,
    MOST_DEG,
    MOST_MM,
    load_sign_findings,
    root_mean_square,
)
from identknee.laxity.protocol import unloaded_trials
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding, finding

# Share of the misfit that a convention has to remove, and share of it that the linear model at the
# start has to predict before a fit is made.
REMOVED, PROMISED = 0.9, 0.5
MOST_FITS = 4
# Of the measured trials, those with an equilibrium at the start.
LEAST_SHARE = 0.5
# Another convention that leaves no more than so many times the misfit is as good.
AS_GOOD = 1.5
BUDGET = 80


@declared
class BrokenConvention:
    """A convention whose change removes nearly all of the misfit, and leaves a plausible one."""

    what: str = entry("The change of the table that puts it right")
    removed: float = entry("Share of the misfit that it removes", unit="1")
    mm_before: float = entry("Error of the lengths in the table as it is", unit="mm")
    deg_before: float = entry("Error of the angles in the table as it is", unit="deg")
    mm_after: float = entry("Error of the lengths in the table put right", unit="mm")
    deg_after: float = entry("Error of the angles in the table put right", unit="deg")
    others: tuple[str, ...] = entry("Other changes that do as well")

    @property
    def sentence(self) -> str:
        """What was found and what to do."""
        sizes = ((self.mm_before, self.mm_after, "mm"), (self.deg_before, self.deg_after, "deg"))
        known = [x for x in sizes if np.isfinite(x[0]) and np.isfinite(x[1])]
        falls = " and ".join(f"from {a:.3g} to {b:.3g} {unit}" for a, b, unit in known)
        also = f" So does {' or '.join(self.others)}." if self.others else ""
        what = self.what[:1].upper() + self.what[1:]
        return (
            f"{what} removes {min(100.0 * self.removed, 99.0):.0f} % of the misfit (the error "
            f"falls {falls}), and what is left is plausible: the table violates this convention, "
            f"and no fit to it is valid.{also} Correct the table and repeat the command."
        )

    @property
    def finding(self) -> Finding:
        """As an answer reports it."""
        values = {
            "what": self.what,
            "removed_share": self.removed,
            "before_mm": self.mm_before,
            "after_mm": self.mm_after,
            "before_deg": self.deg_before,
            "after_deg": self.deg_after,
            "others": self.others,
        }
        return finding("broken-convention", "data", values, sentence=self.sentence)


def find_broken_convention(
    model: LaxityModel, laxity: Laxity, start: Array, fitted: Array | None = None
) -> BrokenConvention | None:
    """The convention that explains why a model does not fit a table; None where none does.

    All are looked at where a fit would begin, with the linear model and the priors of the
    parameters. Only the few with the largest predicted reduction are fitted. Where the table as it
    is leaves no more than noise, nothing is looked for; trials without equilibrium at the start
    count nowhere.

    Parameters
    ----------
    model, laxity
        The model and the data.
    start
        Where fits begin, in all parameters of the model, shape ``(p,)``.
    fitted
        Parameters fitted to the table as it is, shape ``(p,)``; where None they are sought.
    """
    prediction = model.with_tests(laxity).predict(start, derivatives=False)
    measured = laxity.is_measured.any(axis=1)
    if (prediction.is_converged & measured).sum() < max(LEAST_SHARE * measured.sum(), 1):
        return None
    usable = laxity if prediction.all_converged else _selected(laxity, prediction.is_converged)
    if usable is None:
        return None
    as_is = _Table(model, usable)
    theta = as_is.fitted(start) if fitted is None else fitted
    if not as_is.has_prediction(theta) or as_is.is_plausible(theta):
        return None
    found = []
    for convention, table in _promising(as_is, start):
        end = table.fitted(start)
        before, after = table.chi_square_of(as_is.differences(theta)), table.square(end)
        # What noise leaves in any table is no part of the misfit to be removed.
        noise = 0.0 if table.laxity.sd is None else min(after, table.degrees)
        if before - after >= REMOVED * (before - noise) and table.is_plausible_model_misfit(end):
            found.append((after, 1.0 - after / before, convention.what, table.errors(end)))
    if not found:
        return None
    least, removed, what, errors = min(found, key=lambda x: x[0])
    before_mm, before_deg = as_is.errors(theta)
    return BrokenConvention(
        what=what,
        removed=removed,
        mm_before=before_mm,
        deg_before=before_deg,
        mm_after=errors[0],
        deg_after=errors[1],
        others=tuple(x[2] for x in found if x[2] != what and x[0] <= AS_GOOD * least),
    )


def convention_findings(
    model: LaxityModel, laxity: Laxity, start: Array, fitted: Array | None = None
) -> tuple[Finding, ...]:
    """The convention that is broken, if one is.

    Where the model cannot tell, as on a knee without equilibrium at the start, the table alone
    shows whether the tibia moves against its load.
    """
    found = find_broken_convention(model, laxity, start, fitted)
    return load_sign_findings(laxity) if found is None else (found.finding,)


class _Table:
    """A table beside a model: what is left of it, in mm and deg and in units of its noise."""

    def __init__(self, model: LaxityModel, laxity: Laxity) -> None:
        self.laxity = laxity
        self.residuals = LaxityResiduals(model=model, laxity=laxity)
        self.sd = np.ones(laxity.coordinates.shape) if laxity.sd is None else laxity.sd
        self.degrees = max(
            int(laxity.is_measured.sum() - self.residuals.parameters.is_of_interest.sum()), 1
        )

    def fitted(self, start: Array) -> Array:
        """Parameters fitted to it with their priors, shape ``(p,)``."""
        problem = WhitenedResiduals(problem=self.residuals, sd=self.sd[self.laxity.is_measured])
        return fit(problem, start, method="least-squares", budget=BUDGET, priors=True).theta

    def has_prediction(self, theta: Array) -> bool:
        return bool(np.isfinite(self.residuals.residuals(theta)).all())

    def differences(self, theta: Array) -> Array:
        """Measured less predicted, shape ``(n, 5)``; NaN where not measured."""
        return self.residuals.differences(theta)

    def chi_square_of(self, differences: Array) -> float:
        """Sum of squares of differences in units of the noise of this table."""
        return float(np.nansum((differences / self.sd) ** 2))

    def square(self, theta: Array) -> float:
        """Sum of squares of what the model leaves of this table, in units of its noise."""
        return self.chi_square_of(self.differences(theta))

    def is_plausible(self, theta: Array) -> bool:
        """Whether noise alone may leave so much."""
        if self.laxity.sd is None:
            return self._is_small(theta)
        return bool(chdtrc(self.degrees, self.square(theta)) >= IMPROBABLE)

    def is_plausible_model_misfit(self, theta: Array) -> bool:
        """Whether the model of a knee may leave so much: seldom does it fit to the noise."""
        if self.laxity.sd is None:
            return self._is_small(theta)
        return self.square(theta) <= GROSS * self.degrees

    def errors(self, theta: Array) -> tuple[float, float]:
        """Root-mean-square of what is left [mm, deg]; NaN where nothing was measured."""
        left = self.differences(theta)
        return root_mean_square(left[:, TRANSLATIONS]), root_mean_square(left[:, ROTATIONS])

    def linearised_residuals(self, start: Array) -> Array:
        """Residuals of the model linearised at `start`, with the priors, shape ``(n, 5)``."""
        measured, parameters = self.laxity.is_measured, self.residuals.parameters
        left = self.differences(start)
        slopes = -self.residuals.jacobian(start) * parameters.prior_sd_in_own_units
        sd = self.sd[measured]
        step = np.linalg.lstsq(
            np.vstack([slopes / sd[:, None], np.eye(parameters.n)]),
            np.r_[-left[measured] / sd, np.zeros(parameters.n)],
            rcond=None,
        )[0]
        left[measured] += slopes @ step
        return left

    def _is_small(self, theta: Array) -> bool:
        mm, deg = self.errors(theta)
        return not mm > MOST_MM and not deg > MOST_DEG


def _selected(laxity: Laxity, rows: BoolArray) -> Laxity | None:
    try:
        part = laxity.select(rows)
        if laxity.zero == "unloaded":
            unloaded_trials(part.protocol)
    except ValueError:
        return None
    return part


def _promising(as_is: _Table, start: Array) -> list[tuple[Convention, _Table]]:
    here, found = as_is.linearised_residuals(start), []
    for convention in conventions_of(as_is.laxity):
        changed = convention.applied(as_is.laxity)
        if changed is None:
            continue
        table = _Table(as_is.residuals.model, changed)
        if not table.has_prediction(start):
            continue
        share = table.chi_square_of(table.linearised_residuals(start)) / table.chi_square_of(here)
        if share <= PROMISED:
            found.append((share, convention, table))
    found.sort(key=lambda x: x[0])
    return [(convention, table) for _, convention, table in found[:MOST_FITS]]
