"""What the verbs of identifiability share: data and model in units of noise, and their options."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import identknee as ik
from identknee.cli.command import knee_digest, warm_up
from identknee.cli.values import named_bounds, noise_sizes
from identknee.runs.files import digest

WORK = "unfinished.sqlite"

Noise = Annotated[
    str | None,
    typer.Option(
        metavar="MM,DEG",
        help="Standard deviation of the data, as in 0.5mm,0.5deg, in place of their sd_ columns.",
    ),
]
Start = Annotated[str, typer.Option(help="IG1, IG2, IG3, IG4, subject, or a file ending in .toml.")]
Fixed = Annotated[
    list[str] | None,
    typer.Option("--fix", metavar="NAME", help="A parameter held at its start; repeatable."),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a parameter; repeatable."),
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """Measured laxity and the model of it, ready to be asked what they determine.

    Attributes
    ----------
    knee, laxity, model
        The subject, the data and the model under the protocol of the data.
    problem
        Residuals in units of their noise, over the parameters not fixed.
    start
        Theta of all parameters of the model, fixed ones at the value they keep, shape ``(p,)``.
    free
        Where the parameters of the problem stand among those of the model.
    degrees_of_freedom
        Of a noise estimated from the fit; None where the noise is stated.
    assumptions
        What was taken for granted, as sentences for the user.
    inputs
        SHA-256 of each input by name.
    """

    knee: "ik.Knee"
    laxity: "ik.Laxity"
    model: "ik.LaxityModel"
    problem: "ik.Problem"
    start: Any
    free: tuple[int, ...]
    degrees_of_freedom: int | None
    assumptions: tuple[str, ...]
    inputs: dict[str, str]

    def whole(self, theta: Any) -> Any:
        """Theta of the model from that of the problem, shape ``(p,)`` or ``(..., p)``."""
        values = np.array(np.broadcast_to(self.start, (*np.shape(theta)[:-1], self.start.size)))
        values[..., list(self.free)] = theta
        return values


def identification(
    subject: str,
    data: Path,
    *,
    noise: str | None = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    bounds: Sequence[str] | None = None,
) -> Identification:
    """Subject and data, read, checked and compared in units of the noise.

    Raises
    ------
    ValueError
        If an option or a file is wrong, or the data cannot say anything about the noise that they
        leave unstated.
    """
    from identknee.calibrate.problem import restricted

    limits = named_bounds(bounds or [], "--bounds")
    laxity, knee = ik.read_laxity(data), ik.read_subject(subject)
    laxity = laxity if noise is None else _with_stated_noise(laxity, noise)
    model = ik.LaxityModel(knee=knee, protocol=laxity.protocol)
    residuals = ik.LaxityResiduals(
        model=model, laxity=laxity, weighting="unit" if laxity.sd is None else "noise"
    )
    theta = ik.load_start(start, ik.with_bounds(residuals, limits).parameters)
    part = restricted(ik.with_bounds(residuals, limits), fixed or (), theta)
    warm_up(knee, laxity.protocol)
    problem: ik.Problem = part
    degrees, assumptions = None, [*_about_the_data(laxity, part.parameters.n)]
    if laxity.sd is None:
        problem, degrees, sentence = _with_estimated_noise(part, residuals, theta)
        assumptions.append(sentence)
    return Identification(
        knee=knee,
        laxity=laxity,
        model=model,
        problem=problem,
        start=theta,
        free=part.free,
        degrees_of_freedom=degrees,
        assumptions=tuple(assumptions),
        inputs={"subject": knee_digest(knee), "data": digest(data)},
    )


def _with_stated_noise(laxity: "ik.Laxity", noise: str) -> "ik.Laxity":
    from dataclasses import replace

    mm, deg = noise_sizes(noise)
    if mm <= 0 or deg <= 0:
        raise ValueError(f"--noise {noise}: both must be more than 0, for example 0.5mm,0.5deg")
    sd = np.where(laxity.is_measured, np.array([mm] * 3 + [deg] * 2), np.nan)
    return replace(laxity, sd=sd)


def _with_estimated_noise(
    part: Any, residuals: "ik.LaxityResiduals", theta: Any
) -> "tuple[ik.Problem, int, str]":
    from identknee.identify.noise import with_estimated_noise

    # Where only lengths or only angles were measured there is one group.
    units, groups = np.unique(residuals.units, return_inverse=True)
    found = with_estimated_noise(part, groups, theta[list(part.free)])
    sizes = ", ".join(
        f"{sd:.3g} {('mm', 'deg')[unit]}" for sd, unit in zip(found.sds, units, strict=True)
    )
    sentence = (
        f"The data state no noise: one standard deviation for lengths and one for angles was "
        f"estimated from what the best fit leaves ({sizes}, {found.degrees_of_freedom} degrees of "
        "freedom), and F thresholds are used."
    )
    return found.problem, found.degrees_of_freedom, sentence


def _about_the_data(laxity: "ik.Laxity", n_parameters: int) -> list[str]:
    from identknee.laxity.table import COORDINATES

    measured = laxity.is_measured
    sentences = [
        f"{name} was not measured."
        for name, column in zip(COORDINATES, measured.T, strict=True)
        if not column.any()
    ]
    n = int(measured.sum())
    if n == 0:
        raise ValueError("no coordinate was measured in any trial; fill in at least one column")
    if n < n_parameters:
        sentences.append(
            f"{n} measured values cannot determine {n_parameters} parameters: some intervals must "
            "be open. Measure more trials, or hold parameters with --fix."
        )
    return sentences
