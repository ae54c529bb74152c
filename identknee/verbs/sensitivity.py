"""Which parameters the laxity of a knee depends on."""

import math
from pathlib import Path
from typing import Annotated, Literal, Unpack

import numpy as np
import xarray

from identknee.calibrate.fit import load_start
from identknee.identify.sensitivity import DEFAULT_DRAWS, Box, Sensitivity, box_around
from identknee.identify.sensitivity import Method as Kind
from identknee.identify.sensitivity import sensitivity as analysed
from identknee.laxity.table import Laxity, TrialsLike, read_tests
from identknee.laxity.trial_words import LaxityGroup, laxity_groups
from identknee.model.laxity_model import model_for_tests
from identknee.model.quantities import LaxityOutputs
from identknee.runs.declare import Array, declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, digest
from identknee.runs.findings import finding
from identknee.verbs import options
from identknee.verbs.answer import Answer
from identknee.verbs.identification import best_fits, identification
from identknee.verbs.options import option, trials_option
from identknee.verbs.verb import Run, not_resume_relevant, verb, warm_up

Around = Literal["start", "fit"]


@declared
class GlobalSensitivity(Answer):
    """Which parameters the laxity of a knee depends on."""

    analysis: Sensitivity = entry("The analysis", group="sensitivity", is_inline=True)
    laxity_groups: tuple[LaxityGroup, ...] = entry(
        "What the groups of outputs are, in the order of their names", default=()
    )

    def group_named(self, name: str) -> LaxityGroup | None:
        """The group of this name; None for failure, and in results of earlier versions."""
        return next((x for x in self.laxity_groups if x.name == name), None)


@verb
@not_resume_relevant("method", "samples")
def sensitivity(
    run: Run,
    subject: options.Subject,
    data: options.MaybeData = None,
    *,
    protocol: Annotated[
        TrialsLike | None,
        trials_option("The trials, if there is no {DATA}: {}. If not given: seed63."),
    ] = None,
    method: Annotated[
        Kind,
        option(
            "morris and sobol vary the parameters independently: stiffness by +-50 % and reference "
            "strain by +-3 %. The others use the draws of {--posterior}, or draws from the same "
            "ranges."
        ),
    ] = "sobol",
    samples: Annotated[
        int | None,
        option(
            "Number of trajectories for morris (256 if not given), blocks for sobol (1,024) or "
            "draws (2,048). With a larger number and the same {--out} the run goes on."
        ),
    ] = None,
    posterior: Annotated[
        PathLike | None,
        option("Results folder of: identknee sample.", metavar="DIR", typed=Path | None),
    ] = None,
    around: Annotated[
        Around | None,
        option(
            "Middle of the ranges. start: {--start}. fit: the best fit to {DATA}, where errors of "
            "geometry stay at their values there. If not given: fit where every trial of {DATA} "
            "has its own flexion angle, else start."
        ),
    ] = None,
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> GlobalSensitivity:
    """Which parameters the laxity of a knee depends on.

    Laxity is grouped by coordinate, flexion angle and kind of load. Trials without a stable pose
    are an output of their own. Parameters vary around {--around}. All indices, with confidence
    intervals and convergence, are in result.nc.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do. That no simulation has all
        predictions is no error: the answer says it in `failure`.
    """
    if data is not None and protocol is not None:
        raise ValueError(
            "the trials are those of DATA.csv or those of --protocol; give one of the two"
        )
    planned = "seed63" if protocol is None else protocol
    tests = read_tests(planned) if data is None else data
    model = model_for_tests(subject, tests)
    if around is None:
        around = "fit" if data is not None and model.poses is not None else "start"
    if around == "start":
        said: tuple[str, ...] = ()
        middle = load_start(start, model.parameters)
    elif data is None:
        raise ValueError("--around fit needs measured laxity; give DATA.csv, or use --around start")
    else:
        setup = identification(subject, data, noise=noise, start=start, fixed=fixed)
        best = best_fits(setup, seed=seed, executor=run.executor)[0]
        model, tests, middle = setup.model, setup.laxity, setup.free.expand(best.theta)
        said = (*setup.assumptions, f"Parameters vary around the best fit. {best.message}")
    held = {*(fixed or ()), *model.parameters.nuisance_names}
    free = model.parameters.with_fixed(tuple(held), middle)
    if free.parameters.n < 2:
        raise ValueError(
            "a sensitivity analysis needs at least two parameters that vary; fix fewer"
        )
    outputs = LaxityOutputs(
        model=model,
        groups=tuple(x.name for x in laxity_groups(model.protocol)),
        free=free,
        zero=tests.zero if isinstance(tests, Laxity) else "absolute",
    )
    over = _where(run, outputs, posterior, samples)
    warm_up(subject, outputs.model.protocol)
    run.start_clock()
    found = analysed(
        outputs,
        over,
        method=method,
        n_samples=samples,
        seed=seed,
        executor=run.executor,
        store=run.store,
    )
    groups = {x.name: x for x in laxity_groups(outputs.model.protocol)}
    nothing = (finding("no-set-converges", "trials"),) if found.share_failed == 1.0 else ()
    return GlobalSensitivity(
        analysis=found,
        laxity_groups=tuple(groups.values()),
        assumptions=said,
        findings=nothing,
    )


def _where(
    run: Run, outputs: LaxityOutputs, posterior: PathLike | None, samples: int | None
) -> Box | Array:
    """The box, or draws of a posterior, whose number decides which they are."""
    if posterior is None:
        middle = outputs.free.restrict(outputs.free.fixed_values)
        return box_around(outputs.parameters, middle)
    draws = posterior_draws(posterior, outputs.parameters.names, samples or DEFAULT_DRAWS)
    run.add_resume_condition(draws=digest(np.ascontiguousarray(draws).tobytes()))
    return draws


ARRAYS, POSTERIOR, THETA = "result.nc", "posterior", "theta"


def posterior_draws(folder: PathLike, names: tuple[str, ...], n: int) -> Array:
    """At most n draws of the parameters called `names` from what ``identknee sample`` left.

    They are evenly spread over all chains and steps, shape ``(n, p)``.

    Raises
    ------
    InputError
        If the folder has no posterior, or that of other parameters.
    """
    path = Path(folder) / ARRAYS
    remedy = "Give the folder --out of an identknee sample that has ended."
    if not path.is_file():
        raise InputError(path, "", "there are no results to read", remedy)
    try:
        with xarray.open_datatree(path, engine="netcdf4") as tree:
            data = tree[POSTERIOR].to_dataset().load() if POSTERIOR in tree.children else None
    # The library tells a damaged file by either.
    except (OSError, RuntimeError) as error:
        raise InputError(path, "", f"there are no results to read ({error})", remedy) from error
    if data is None:
        raise InputError(path, "", "there is no posterior in these results", remedy)
    draws = _by_name(data, names)
    if draws is None:
        why = f"its posterior is not one of {', '.join(names)}"
        raise InputError(path, POSTERIOR, why, "Sample and analyse with the same --fix.")
    step = max(1, math.ceil(len(draws) / n))
    return np.asarray(draws[::step])


def _by_name(data: xarray.Dataset, names: tuple[str, ...]) -> Array | None:
    """Draws of the parameters in this order, from one variable for all or one for each."""
    if THETA in data:
        theta = data[THETA]
        known = [str(x) for x in theta["parameter"].values] if "parameter" in theta.coords else []
        if set(known) != set(names):
            return None
        values = theta.transpose(..., "parameter").sel(parameter=list(names)).values
        return np.asarray(values.reshape(-1, len(names)), dtype=np.float64)
    if not all(name in data for name in names):
        return None
    return np.column_stack([data[name].values.ravel() for name in names])
