"""How strongly residuals speak for a force along each of thousands of lines."""

from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.base_fit import Fitted
from identknee.diagnosis.line_candidates import SLACK_STRAINS, CandidateLines, line_columns
from identknee.diagnosis.projection import base_projector
from identknee.diagnosis.weighing import weighed
from identknee.runs.arrays import Array, frozen

NAME = "missing_line"
STIFFNESS_SD = 1.5  # kN, of the half-normal prior
APART = 12.0  # mm
N_DRAWS = 1000
# A line of which less is left is explained by the fitted parameters.
LEAST_LEFT = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScannedLine:
    """A line worth a refit.

    Attributes
    ----------
    femur, tibia
        Its ends in the common frame of the scanned pose [mm], shape ``(3,)``.
    amplitude, strain_pct
        Its expected stiffness [kN] and the slack strain [%] at which it explains most.
    score
        Root of the expected fall of the objective.
    """

    femur: Array
    tibia: Array
    amplitude: float
    strain_pct: float
    score: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineScan:
    """Scores of all lines in one linearisation of a model.

    Attributes
    ----------
    lines
        All m lines.
    scores
        Root of the expected fall of the objective for each slack strain and line, shape
        ``(strains, m)``; 0 where a line would have to push.
    amplitudes
        Expected stiffness of each [kN], same shape.
    signatures
        What is left of each line's effect after all that the parameters explain, in units of the
        noise and so long that its product with the residuals is the score, ``(rows, strains, m)``.
    """

    lines: CandidateLines
    scores: Array
    amplitudes: Array
    signatures: Array

    def __post_init__(self) -> None:
        shape = (len(SLACK_STRAINS), self.lines.n)
        for name in ("scores", "amplitudes"):
            object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))

    def best(self, number: int) -> tuple[ScannedLine, ...]:
        """The lines of the highest scores, no two of them close to each other."""
        highest, strain = self.scores.max(axis=0), self.scores.argmax(axis=0)
        found: list[ScannedLine] = []
        is_free = highest > 0.0
        while is_free.any() and len(found) < number:
            line = int(np.argmax(np.where(is_free, highest, 0.0)))
            found.append(
                ScannedLine(
                    femur=self.lines.femur[line],
                    tibia=self.lines.tibia[line],
                    amplitude=float(self.amplitudes[strain[line], line]),
                    strain_pct=SLACK_STRAINS[strain[line]],
                    score=float(highest[line]),
                )
            )
            is_free &= ~self.lines.close_to(line, APART)
        return tuple(found)

    def p_value(self, seed: int) -> float:
        """Probability that noise alone gives some line a score as high as the highest."""
        draws = np.random.default_rng(seed).standard_normal((N_DRAWS, len(self.signatures)))
        highest = np.zeros(N_DRAWS)
        for strain in range(len(SLACK_STRAINS)):
            np.maximum(highest, (draws @ self.signatures[:, strain]).max(axis=1), out=highest)
        return float((1 + np.count_nonzero(highest >= self.scores.max())) / (1 + N_DRAWS))


def scan_lines(fitted: Fitted, theta: Array, lines: CandidateLines) -> LineScan | None:
    """Scores of lines of action where a model is linearised at `theta`.

    Theta need not be the best fit: what a change of it could explain is taken out. If the model
    has a missing line already, the scan is for what might take its place. None where the model has
    no prediction at theta.

    Parameters
    ----------
    fitted
        The model, the data and their noise.
    theta
        Where, shape ``(p,)``.
    lines
        The lines to score.
    """
    problem = weighed(fitted.model, fitted.laxity, fitted.noise)
    residuals = -problem.residuals(theta)
    if not np.isfinite(residuals).all():
        return None
    residuals, jacobian = _without_line(fitted, theta, residuals, problem.jacobian(theta))
    changes = line_columns(fitted.model, fitted.model.predict_once(theta), lines)
    signatures = fitted.columns(changes.reshape(*changes.shape[:2], -1))
    projector = base_projector(jacobian)
    left = projector.project(signatures)
    square = (left**2).sum(axis=0)
    is_seen = square > LEAST_LEFT**2 * (signatures**2).sum(axis=0)
    precision = square + STIFFNESS_SD**-2.0
    left *= is_seen / np.sqrt(precision)
    scores = np.maximum(projector.project(residuals) @ left, 0.0)
    shape = (len(SLACK_STRAINS), lines.n)
    return LineScan(
        lines=lines,
        scores=scores.reshape(shape),
        amplitudes=(scores / np.sqrt(precision)).reshape(shape),
        signatures=left.reshape(-1, *shape),
    )


def _without_line(
    fitted: Fitted, theta: Array, residuals: Array, jacobian: Array
) -> tuple[Array, Array]:
    """Rows of the residuals and of their Jacobian without those of a line the model has already."""
    names = fitted.model.parameters.names
    kept = [i for i, name in enumerate(names) if not name.startswith(f"{NAME}.")]
    if len(kept) == len(names):
        return residuals, jacobian
    # Its force is proportional to its stiffness, the first of its parameters.
    stiffness = len(kept)
    rows = np.r_[np.arange(fitted.n_data), fitted.n_data + np.array(kept)]
    removed = residuals + jacobian[:, stiffness] * theta[stiffness]
    return removed[rows], jacobian[np.ix_(rows, kept)]
