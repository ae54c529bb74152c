"""What speaks against the data that parameters were fitted to, the whole table first."""

from collections.abc import Sequence

from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, Severity
from identknee.scrutiny.against_load import against_load_findings
from identknee.scrutiny.broken_convention import convention_findings
from identknee.scrutiny.contradictions import end_point_findings, row_findings
from identknee.scrutiny.whole_table import load_findings, pose_findings


def data_findings(
    model: LaxityModel,
    laxity: Laxity,
    begun_and_fitted: tuple[Array, Array],
    fixed: Sequence[str],
    misfit: tuple[Finding, ...],
) -> tuple[Finding, ...]:
    """What speaks against the data at a fit, then what was found of its misfit.

    Conventions are looked for only where the misfit is more than noise, and a broken one explains
    rows that do not go together.

    Parameters
    ----------
    model, laxity
        What was fitted to what.
    begun_and_fitted
        Parameters of the model where the search began and where it ended, each shape ``(p,)``.
    fixed
        Names of parameters that were not asked for.
    misfit
        What was found of the misfit and of bounds.
    """
    start, theta = begun_and_fitted
    if any(x.severity is not Severity.INFO for x in misfit):
        conventions = convention_findings(model, laxity, start, theta)
        if conventions:
            return (*conventions, *misfit)
    rows = row_findings(model, laxity, theta, fixed=fixed)
    return beside_the_table(model, laxity, (*rows, *misfit))


def beside_the_table(
    model: LaxityModel, laxity: Laxity, findings: tuple[Finding, ...]
) -> tuple[Finding, ...]:
    """The findings, behind what the table says by itself where fits begin at its poses.

    A table with a sign turned loses trials too: the sign is said first.
    """
    findings = (*load_findings(laxity), *findings)
    if model.poses is None:
        return findings
    named = {x.where for x in findings}
    rows = tuple(x for x in end_point_findings(laxity) if x.where not in named)
    # What is wrong with the whole table makes its trials contradict one another.
    whole = (*pose_findings(model), *against_load_findings(laxity))
    return (*whole, *(x for x in (*rows, *findings) if x not in whole))
