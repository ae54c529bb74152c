"""What the verbs of identifiability share: data and model in units of noise, and their options."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import identknee as ik
from identknee.cli.command import NotComputed, knee_digest, warm_up
from identknee.cli.values import named_bounds, noise_sizes
from identknee.laxity.named_tables import laxity_file
from identknee.runs.executors import Executor
from identknee.runs.files import PathLike, digest
from identknee.runs.findings import Finding, Severity

if TYPE_CHECKING:
    from identknee.identify.noise import EstimatedNoise
    from identknee.model.parameters import FreeParameters

# Of lengths and of angles [mm, deg].
Sizes = tuple[float | None, float | None]
WORK = "unfinished.sqlite"

Noise = Annotated[
    str | None,
    typer.Option(
        metavar="MM,DEG",
        help="Standard deviations of lengths and angles, as in 0.5mm,0.5deg, in place of the sd_ "
        "columns of the data.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Where fits begin, and the values of --fix: subject (its own values), IG1 to IG4 of "
        "the paper, or a file ending in .toml."
    ),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option(
        "--fix",
        metavar="NAME",
        help="A parameter held at its start, such as ACL.stiffness_kN; repeatable.",
    ),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=LOW:HIGH",
        help="Bounds in place of 0 to 40 kN and -15 to 15 %, as in ACL.stiffness_kN=5:15; "
        "repeatable.",
    ),
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
    free
        The parameters of the problem, and the values of those of the model that are fixed.
    start
        Where fits begin, shape ``(n,)``.
    degrees_of_freedom
        Of a noise estimated from the fit; None where the noise is stated.
    estimated_noise
        Its standard deviation for lengths and for angles [mm, deg]; None where it is stated or no
        such coordinate was measured.
    assumptions
        What was taken for granted, as sentences for the user.
    inputs
        SHA-256 of each input by name.
    """

    knee: "ik.Knee"
    laxity: "ik.Laxity"
    model: "ik.LaxityModel"
    problem: "ik.Problem"
    free: "FreeParameters"
    start: Any
    degrees_of_freedom: int | None
    estimated_noise: Sizes
    assumptions: tuple[str, ...]
    inputs: dict[str, str]

    def findings_at(
        self, theta: Any, deviance: float, fits: "Sequence[ik.Fit]" = ()
    ) -> tuple[Finding, ...]:
        """What speaks against the best fit: its misfit, its bounds, other fits, and the model.

        Parameters
        ----------
        theta
            The best parameters of the problem, shape ``(n,)``.
        deviance
            Sum of squared residuals there, in units of their noise.
        fits
            All fits that it is the best of.
        """
        from identknee.calibrate.doubts import (
            bound_findings,
            misfit_findings,
            start_findings,
            unstated_misfit_findings,
        )
        from identknee.identify.feasibility import feasibility_findings
        from identknee.model.soundness import rim_findings, stability_findings

        parameters = self.problem.parameters
        model = (
            *stability_findings(self.model),
            *feasibility_findings(self.problem, np.asarray(theta)),
            *rim_findings(
                self.model.protocol.trials, self.model.predict_once(self.free.expand(theta))
            ),
        )
        if self.degrees_of_freedom is None:
            n = int(self.laxity.is_measured.sum())
            misfit = misfit_findings(deviance, n, parameters.n)
        else:
            # That the noise was estimated is among the assumptions.
            left = unstated_misfit_findings(*self.estimated_noise)
            misfit = tuple(x for x in left if x.severity is not Severity.INFO)
        bounds = bound_findings(np.asarray(theta), parameters)
        if not fits:
            return (*misfit, *bounds, *model)
        thetas = np.array([x.theta for x in fits])
        deviances = 2.0 * np.array([x.objective for x in fits])
        return (*misfit, *bounds, *start_findings(thetas, deviances, parameters), *model)

    def free_index(self, name: str, option: str) -> int:
        """Where the parameter called `name` stands among those that vary.

        Raises
        ------
        ValueError
            If there is no such parameter, or `--fix` holds it.
        """
        index = self.model.parameters.index(name)
        if index not in self.free.free_indices:
            raise ValueError(f"{option} {name}: --fix holds this parameter; leave out one of both")
        return self.free.free_indices.index(index)


def identification(
    subject: str,
    data: PathLike,
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
    knee, laxity = measured(subject, data, noise)
    model = ik.LaxityModel(knee=knee, protocol=laxity.protocol)
    residuals = ik.LaxityResiduals(
        model=model, laxity=laxity, weighting="unit" if laxity.sd is None else "noise"
    )
    theta = ik.load_start(start, ik.with_bounds(residuals, limits).parameters)
    part = restricted(ik.with_bounds(residuals, limits), fixed or (), theta)
    warm_up(knee, laxity.protocol)
    problem: ik.Problem = part
    degrees: int | None = None
    sizes: Sizes = (None, None)
    assumptions = _about_the_data(laxity, part.parameters.n)
    if laxity.sd is None:
        estimate, sizes = _with_estimated_noise(part, residuals, theta)
        problem, degrees = estimate.problem, estimate.degrees_of_freedom
        assumptions.append(_about_estimated_noise(sizes, degrees))
    return Identification(
        knee=knee,
        laxity=laxity,
        model=model,
        problem=problem,
        free=part.free,
        start=part.free.restrict(theta),
        degrees_of_freedom=degrees,
        estimated_noise=sizes,
        assumptions=tuple(assumptions),
        inputs={
            "subject": knee_digest(knee),
            "data": digest(laxity_file(data)),
            **file_digests(start=start),
        },
    )


def measured(subject: str, data: PathLike, noise: str | None) -> "tuple[ik.Knee, ik.Laxity]":
    """Subject and data, the noise of the data as `--noise` says where it is given.

    Raises
    ------
    ValueError
        If a file or the noise is wrong, or the data state the noise of some coordinates only.
    """
    laxity, knee = ik.read_laxity(data), ik.read_subject(subject)
    laxity = laxity if noise is None else _with_stated_noise(laxity, noise)
    _check_stated_noise(laxity)
    return knee, laxity


def best_fits(its: Identification, *, seed: int, executor: Executor) -> "tuple[ik.Fit, ...]":
    """Fits from the start and from around it, the lowest first.

    Raises
    ------
    ValueError
        If the start lies outside the bounds.
    NotComputed
        If none of them found a prediction; it says which trials are to blame.
    """
    from identknee.identify.optimum import best_fits as find

    check_start(its)
    try:
        return find(its.problem, start=its.start, seed=seed, executor=executor)
    except ValueError as error:
        raise no_prediction(its) from error


def check_start(its: Identification) -> None:
    """Refuse a start outside the bounds.

    Raises
    ------
    ValueError
        Naming the first parameter that is outside.
    """
    from identknee.identify.optimum import check_inside

    check_inside(its.start, its.problem.parameters)


def no_prediction(its: Identification) -> NotComputed:
    """The error that no parameters near the start predict all measured trials; it names them."""
    return _no_prediction(its.model, its.laxity, its.free.fixed_values)


def _no_prediction(model: "ik.LaxityModel", laxity: "ik.Laxity", start: Any) -> NotComputed:
    prediction = model.predict(start, derivatives=False)
    used = np.any(laxity.is_measured, axis=1).tolist()
    lost = [
        (trial, outcome)
        for trial, outcome, is_used in zip(
            model.protocol.trials, prediction.outcomes, used, strict=True
        )
        if is_used and outcome is not ik.Outcome.CONVERGED
    ]
    where = ""
    if lost:
        trial, outcome = lost[0]
        where = (
            f" (at the start {len(lost)} of {sum(used)} trials have none; {trial}: "
            f"{outcome.sentence.rstrip('.')})"
        )
    return NotComputed(
        f"no parameters near the start have a prediction in every measured trial{where}. Choose "
        "another --start, leave the cells of such trials blank, or see: identknee subject check"
    )


def file_digests(**options: str | None) -> dict[str, str]:
    """SHA-256, by option, of those options that name a file rather than something built in."""
    return {
        name: digest(value)
        for name, value in options.items()
        if value is not None and Path(value).suffix == ".toml" and Path(value).is_file()
    }


def _with_stated_noise(laxity: "ik.Laxity", noise: str) -> "ik.Laxity":
    from dataclasses import replace

    mm, deg = noise_sizes(noise)
    sd = np.where(laxity.is_measured, np.array([mm] * 3 + [deg] * 2), np.nan)
    return replace(laxity, sd=sd)


def _check_stated_noise(laxity: "ik.Laxity") -> None:
    from identknee.laxity.table import COORDINATES

    if laxity.sd is None:
        return
    lacking = np.any(np.isnan(laxity.sd) & laxity.is_measured, axis=0).tolist()
    if any(lacking):
        columns = [f"sd_{x}" for x, lacks in zip(COORDINATES, lacking, strict=True) if lacks]
        raise ValueError(
            f"the data state the noise of some coordinates only: {', '.join(columns)} is missing. "
            "Add it, or state the noise of all with --noise, for example --noise 0.5mm,0.5deg"
        )


def _with_estimated_noise(
    part: Any, residuals: "ik.LaxityResiduals", theta: Any
) -> "tuple[EstimatedNoise, Sizes]":
    from identknee.identify.noise import with_estimated_noise

    if not np.isfinite(residuals.residuals(theta)).all():
        raise _no_prediction(residuals.model, residuals.laxity, theta)
    # Where only lengths or only angles were measured there is one group.
    units, groups = np.unique(residuals.units, return_inverse=True)
    found = with_estimated_noise(part, groups, part.free.restrict(theta))
    sizes = dict(zip(units.tolist(), found.sds.tolist(), strict=True))
    return found, (sizes.get(0), sizes.get(1))


def _about_estimated_noise(sizes: Sizes, degrees: int) -> str:
    shown = ", ".join(
        f"{sd:.3g} {unit}" for sd, unit in zip(sizes, ("mm", "deg"), strict=True) if sd is not None
    )
    return (
        "The data state no noise: one standard deviation for lengths and one for angles was "
        f"estimated from what the best fit leaves ({shown}, {degrees} degrees of freedom), and F "
        "thresholds are used."
    )


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
