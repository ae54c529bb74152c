"""Suspicious rows of data that are diagnosed, and the verdict without them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.diagnosis.investigation import Investigation, investigate
from identknee.model.effects.effect import Effect
from identknee.runs.findings import Finding
from identknee.scrutiny.contradictions import told, without_rows
from identknee.scrutiny.suspicious_rows import SuspiciousRow, left_out, suspicious_rows

AGAINST = "what the fit to the other trials says"


def rows_of(found: Investigation) -> list[SuspiciousRow]:
    """The trials that the other ones contradict, beside the best explanation of the misfit."""
    fitted = found.explanation.fitted
    rows, jacobian = fitted.residual_rows(), fitted.evaluation.jacobian
    whitened = fitted.noise.whiten(np.eye(fitted.n_data))
    columns = np.vstack([whitened, np.zeros((len(rows) - fitted.n_data, fitted.n_data))])
    measured = fitted.laxity.is_measured
    return suspicious_rows(left_out(rows, jacobian, columns), *np.nonzero(measured))


def row_findings_of(
    found: Investigation, *, effects: Sequence[Effect] | None, seed: int
) -> tuple[Finding, ...]:
    """The suspicious rows of a diagnosis, with the verdict that the other trials have.

    Parameters
    ----------
    found
        The fits behind the diagnosis.
    effects, seed
        As in `identknee.diagnosis.investigation.investigate`, which is done again without them.
    """
    rows = rows_of(found)
    if not rows:
        return ()
    knee = found.base.fitted.model.knee
    rest = investigate(knee, without_rows(found.laxity, rows), effects=effects, seed=seed)
    it = "it" if len(rows) == 1 else "these trials"
    if rest is None:
        verdict = f"Without {it} the data cannot be tested."
    else:
        names = f" ({' and '.join(x.name for x in rest.causes)})" if rest.causes else ""
        same = rest.conclusion.verdict is found.conclusion.verdict
        verdict = (
            f"Without {it} the verdict is {'still ' if same else ''}"
            f"{rest.conclusion.verdict.value}{names}."
        )
    *others, last = told(rows, found.laxity, AGAINST)
    return (*others, replace(last, sentence=f"{last.sentence} {verdict}"))
