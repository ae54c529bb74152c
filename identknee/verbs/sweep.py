"""Where searches from many starts end, and why there."""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Literal, Unpack

import numpy as np

from identknee.calibrate.fit import BUDGET, Fit
from identknee.calibrate.problem import evidence_terms
from identknee.checks.fit_checks import SAME, start_findings
from identknee.identify.cliffs import CliffMap, map_cliffs
from identknee.identify.sweep import (
    STARTS_A_TASK,
    WITHIN,
    Survey,
    SweepSearches,
    shell_starts,
    sobol_starts,
)
from identknee.identify.sweep import survey as surveyed
from identknee.identify.sweep import sweep as searched
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import FreeParameters
from identknee.runs.declare import Array, IntArray, array, declared, entry
from identknee.runs.findings import Finding
from identknee.runs.progress import planned
from identknee.verbs import options
from identknee.verbs.answer import Answer, has_priors
from identknee.verbs.identification import (
    Identification,
    best_fits,
    identification,
    no_prediction_finding,
)
from identknee.verbs.options import option
from identknee.verbs.verb import Run, not_resume_relevant, verb

Design = Literal["sobol", "shells"]
DISTANCES = "0,0.5,1,1.5,2,2.5,3,4,5,6"

# Of a path searched for cliffs, in searches by least squares.
PATH_COST = 3.6
# Of a search by least squares with its polishing; other methods use all they may.
USUAL_SIMULATIONS = 25


@declared
class Sweep(Answer):
    """Where searches from many starts end: basins, recovery of the best fit, and cliffs."""

    design: str = entry("Design of the starts, sobol or shells")
    survey: Survey = entry("The searches and what is read from them", is_inline=True)
    best: Fit | None = entry(
        "The best fit that other verbs find, where no polished end is as low; null elsewhere",
        group="best",
        default=None,
    )
    n_trials_lost: IntArray | None = array(
        "Measured trials without equilibrium at each polished end; null where every end has all",
        "start",
        dtype=int,
        default=None,
    )
    cliffs: CliffMap | None = entry(
        "Cliffs on straight paths from starts to the best fit; null where none was looked for",
        group="cliffs",
    )

    @property
    def searches(self) -> SweepSearches:
        """Every search."""
        return self.survey.searches


@verb
@not_resume_relevant("within", "paths")
def sweep(
    run: Run,
    subject: options.Subject,
    data: options.Data,
    *,
    n_starts: Annotated[int, option("Number of starts.", least=1)] = 1000,
    method: options.Method = "least-squares",
    design: Annotated[
        Design,
        option(
            "How starts are placed. sobol: evenly within the bounds. shells: at {--distances} from "
            "{--start}."
        ),
    ] = "sobol",
    distances: Annotated[
        str | Sequence[float],
        option(
            "For shells: mean differences from {--start} in kN and in %, such as 0.5,1,2.",
            in_python="A text, or numbers.",
            metavar="D,D,...",
            typed=str,
        ),
    ] = DISTANCES,
    budget: Annotated[
        int | None, option("Largest number of simulations per search; 2,500 if not given.")
    ] = None,
    within: Annotated[
        float,
        option(
            "A search recovers the best fit if it ends within this mean distance of it, in kN and "
            "in %.",
            least=0.0,
        ),
    ] = WITHIN,
    paths: Annotated[
        int,
        option(
            "For how many starts to search the straight path to the best fit for cliffs.", least=0
        ),
    ] = 100,
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    bounds: options.Bounds = None,
    priors: options.Priors = None,
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> Sweep:
    """Where searches from many starts end, and why there.

    A search may end in a minimum, give up in a valley, or stop at a cliff, where the simulated
    knee jumps. Least squares with exact derivatives goes on from each end, so that only real
    minima count. The answer has the basins with their volumes, how often the best fit is found
    from how far away, and the cliffs on the way. All ends are in result.nc.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do. That no search has a
        prediction is no error: the answer says it in `failure`.
    """
    setup = identification(
        subject,
        data,
        noise=noise,
        start=start,
        fixed=fixed,
        bounds=bounds,
        priors=has_priors("sweep", priors),
    )
    parameters = setup.problem.parameters
    if design == "sobol":
        starts = sobol_starts(parameters, n_starts, seed=seed)
    else:
        shells = _numbers(distances)
        starts = shell_starts(parameters, n_starts, center=setup.start, distances=shells, seed=seed)
    # Nuisances are not of interest: every start has them at the centre of their priors.
    nuisances = ~parameters.is_of_interest
    starts[:, nuisances] = parameters.start[nuisances]
    run.start_clock()
    chunk = STARTS_A_TASK.get(method, 1)
    cost = chunk if method == "least-squares" else BUDGET / USUAL_SIMULATIONS
    with planned(
        "sweeping",
        {
            f"sweeping by {method}": [cost] * -(-n_starts // chunk),
            "cliffs": [PATH_COST] * min(paths, n_starts),
        },
    ):
        searches = searched(
            setup.everywhere,
            starts,
            method=method,
            budget=budget,
            seed=seed,
            executor=run.executor,
            store=run.store,
        )
        # Where searches begin at measured poses, other verbs may know a lower fit.
        is_posed = setup.everywhere is not setup.problem
        lowest = best_fits(setup, seed=seed, executor=run.executor)[0] if is_posed else None
        is_lower = lowest is not None and lowest.objective < searches.lowest_objective - 0.5 * SAME
        survey = surveyed(
            setup.everywhere,
            searches,
            target=lowest.theta if lowest is not None and is_lower else None,
            within=within,
        )
        cliffs = _cliffs(run, setup, survey, paths)
    return Sweep(
        design=design,
        survey=survey,
        best=lowest if is_lower else None,
        n_trials_lost=_numbers_lost(setup, searches),
        cliffs=cliffs,
        assumptions=setup.assumptions,
        trials_used=setup.trials_used,
        uncertainty=setup.knee.uncertainty.words,
        evidence=() if survey.target is None else evidence_terms(setup.problem, survey.target),
        findings=_findings(setup, survey),
    )


def _numbers_lost(setup: Identification, searches: SweepSearches) -> IntArray | None:
    """How many trials used have no equilibrium at each polished end, shape ``(N,)``."""
    if setup.everywhere is setup.problem:
        return None
    measured = setup.laxity.is_measured.any(axis=1)
    predictions = (
        setup.model.predict(setup.free.expand(x), derivatives=False) for x in searches.polished
    )
    return np.array([int(np.sum(measured & ~x.is_converged)) for x in predictions])


def trials_lost(model: LaxityModel, theta: Array) -> list[str]:
    """Names of the trials without an equilibrium at theta."""
    converged = model.predict(theta, derivatives=False).is_converged
    return [
        name
        for name, is_there in zip(model.protocol.trials, converged, strict=True)
        if not is_there
    ]


def _numbers(distances: str | Sequence[float]) -> list[float]:
    if not isinstance(distances, str):
        return [float(x) for x in distances]
    try:
        return [float(x) for x in distances.split(",")]
    except ValueError:
        raise ValueError(
            f"--distances {distances}: these are not numbers. Write for example 0.5,1,2"
        ) from None


def _cliffs(run: Run, setup: Identification, survey: Survey, paths: int) -> CliffMap | None:
    if survey.target is None or paths == 0:
        return None
    return map_cliffs(
        setup.problem,
        survey.searches.starts[:paths],
        survey.target,
        lost_at=partial(_lost, setup.model, setup.free),
        executor=run.executor,
        store=run.store,
    )


def _lost(model: LaxityModel, free: FreeParameters, theta: Array) -> list[str]:
    return trials_lost(model, free.expand(theta))


def _findings(setup: Identification, survey: Survey) -> tuple[Finding, ...]:
    searches = survey.searches
    if survey.target is None:
        return (no_prediction_finding(setup),)
    deviances = 2.0 * searches.polished_objectives
    at_target = setup.problem.residuals(survey.target)
    return (
        *setup.findings_at(survey.target, float(at_target @ at_target)),
        *start_findings(searches.polished, deviances, searches.parameters),
    )
