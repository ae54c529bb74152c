"""Whether it matters how translations are defined, in a table that does not say it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import Problem, typical_steps
from identknee.checks.usable_trials import TrialSearch
from identknee.laxity.protocol import ABSOLUTE
from identknee.laxity.table import COORDINATES, TRANSLATIONS, Laxity
from identknee.laxity.translations import COMPONENTS, DEFINITIONS, Translations, to_components
from identknee.runs.findings import Finding, Severity, finding
from identknee.runs.record import Outcome
from identknee.runs.words import capitalised, label_without_unit, two_values_words

# The definition that other tools compute, and so that of many tables without a stated one.
USUAL: Translations = "projections"
# Assumed noise where none is stated [mm].
UNSTATED_MM = 1.0
# Rise of the deviance by which the data rule a definition out, with a margin for an imperfect model
# and for a search that ended too high.
CLEAR_RISE = 30.0
# Rise of the deviance by the linear model up to which another definition is fitted.
PROMISING = 100.0
BUDGET = 60
MOST_STARTS = 3
# Typical steps (3 kN, 2 %) from which on parameters differ.
APART = 0.1
MOST_NAMED = 2
UNSAID = "The table does not define its translations, and they were read as components."


@dataclass(frozen=True, slots=True, kw_only=True)
class _Change:
    """How much one length changes by another definition, and where."""

    change_mm: float
    trial: str
    coordinate: str


def translations_findings(laxity: Laxity, noise_mm: float | None = None) -> tuple[Finding, ...]:
    """A finding if another definition would change translations by more than the noise.

    Parameters
    ----------
    laxity
        The table as it was read.
    noise_mm
        Standard deviation of lengths; None for those of the table or, where it states none, 1 mm.
    """
    if (most := _largest_change(laxity, USUAL, noise_mm)) is None:
        return ()
    sentence = (
        f"{UNSAID} As {USUAL} the {label_without_unit(most.coordinate)} of {most.trial} would be "
        f"{most.change_mm:.1f} mm off. {_remedy(USUAL)}"
    )
    return (_found(most, sentence),)


def refitted_translations_findings(
    trials: TrialSearch, laxity: Laxity, fits: Sequence[Fit], scale: float
) -> tuple[Finding, ...]:
    """A finding on the parameters by other definitions of translations, and how well these fit.

    Parameters
    ----------
    trials
        The search that the fit came from.
    laxity
        The trials that were fitted.
    fits
        The fit, then the ends of other searches.
    scale
        Variance of the residuals of the fit.
    """
    if not np.isfinite(fits[0].objective):
        return ()
    noise_mm = None if trials.weighting == "noise" else UNSTATED_MM
    made: dict[Translations, tuple[_Change, str, float, dict[str, float]]] = {}
    for definition in DEFINITIONS:
        most = _largest_change(laxity, definition, noise_mm)
        if most is None:
            continue
        problem = trials.problem_everywhere(_by(laxity, definition))
        if definition != USUAL and not _promises(problem, fits[0], scale):
            continue
        other = _refitted(problem, fits)
        rise = (other.deviance - fits[0].deviance) / scale
        if definition != USUAL and not rise <= CLEAR_RISE:
            continue
        names, words = _differences(fits[0], other)
        said = f"as {definition} they differ by up to {most.change_mm:.1f} mm"
        if definition == USUAL:
            how_well = "nothing fits"
            if np.isfinite(rise):
                how_well = f"deviance {abs(rise):.0f} {'higher' if rise > 0 else 'lower'}"
            said += f", with {words[0] if words else 'the same parameters'} ({how_well})"
        values = {x: float(other.theta[other.parameters.index(x)]) for x in names}
        made[definition] = (most, said, float(rise), values)
    if USUAL not in made:
        return ()
    said = "; ".join(x[1] for x in made.values())
    sentence = f"{UNSAID} {capitalised(said)}. {_remedy(*made)}"
    more = {
        "rise": {k: x[2] for k, x in made.items()},
        "parameters": {k: x[3] for k, x in made.items()},
    }
    is_clear = min(x[2] for x in made.values()) > CLEAR_RISE
    severity = Severity.INFO if is_clear else Severity.WARNING
    return (_found(made[USUAL][0], sentence, severity, **more),)


def _remedy(*definitions: str) -> str:
    return f"Add a line: # translations: {' or '.join((COMPONENTS, *definitions))}."


def _differences(found: Fit, other: Fit) -> tuple[list[str], list[str]]:
    """The parameters of interest that differ most between two fits, and both values in words."""
    parameters = found.parameters
    size = np.abs(other.theta - found.theta) / typical_steps(parameters)
    size = np.where(parameters.is_of_interest, size, 0.0)
    apart = [i for i in np.argsort(-size, kind="stable")[:MOST_NAMED] if size[i] > APART]
    names = [parameters.names[i] for i in apart]
    return names, [
        two_values_words(name, found.theta[i], other.theta[i])
        for name, i in zip(names, apart, strict=True)
    ]


def _refitted(problem: Problem, fits: Sequence[Fit]) -> Fit:
    """The lowest fit of `problem`, from the ends of fits to the table as it was read."""
    one = fits[0]
    search = partial(fit, problem, fixed=one.fixed, priors=one.priors, seed=one.seed)
    starts = [x.theta for x in fits if np.isfinite(x.objective)][:MOST_STARTS]
    lowest = min((search(x, budget=BUDGET) for x in starts), key=lambda x: x.objective)
    return search(lowest.theta) if lowest.outcome is Outcome.BUDGET else lowest


def _promises(problem: Problem, found: Fit, scale: float) -> bool:
    """Whether the linear model predicts a misfit low enough for a fit to be worth it."""
    rows, slopes = problem.residuals(found.theta), problem.jacobian(found.theta)
    if not (np.isfinite(rows).all() and np.isfinite(slopes).all()):
        return False
    slopes = slopes * typical_steps(found.parameters)
    step = np.linalg.lstsq(slopes, -rows, rcond=None)[0]
    left = float(np.sum((rows + slopes @ step) ** 2))
    return left - found.deviance <= PROMISING * scale


def _by(laxity: Laxity, definition: Translations) -> Laxity:
    """The table with its numbers read by another definition, as components."""
    flexion = laxity.protocol.flexion_deg
    return replace(laxity, coordinates=to_components(definition, flexion, laxity.coordinates))


def _largest_change(
    laxity: Laxity, definition: Translations, noise_mm: float | None
) -> _Change | None:
    """The largest change of a length by another definition; None within the noise."""
    is_open = not laxity.is_definition_stated and laxity.zero == ABSOLUTE
    if definition == COMPONENTS or not is_open:
        return None
    made = _by(laxity, definition).coordinates
    if (np.isnan(made) != np.isnan(laxity.coordinates)).any():
        return None
    change = np.nan_to_num(np.abs(made - laxity.coordinates)[:, TRANSLATIONS])
    noise = np.full(change.shape, UNSTATED_MM if noise_mm is None else noise_mm)
    if noise_mm is None and laxity.sd is not None:
        noise = np.where(laxity.is_measured, laxity.sd, np.inf)[:, TRANSLATIONS]
        noise = np.nan_to_num(noise, nan=UNSTATED_MM, posinf=np.inf)
    if not (change > noise).any():
        return None
    row, column = np.unravel_index(int(np.argmax(change / noise)), change.shape)
    return _Change(
        change_mm=float(change[row, column]),
        trial=laxity.protocol.trials[row],
        coordinate=COORDINATES[column],
    )


def _found(
    most: _Change, sentence: str, severity: Severity = Severity.WARNING, **values: object
) -> Finding:
    about = {"change_mm": most.change_mm, "trial": most.trial, "coordinate": most.coordinate}
    return finding(
        "translations-ambiguous", "data", about | values, sentence=sentence, severity=severity
    )
