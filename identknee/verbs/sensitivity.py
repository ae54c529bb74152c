"""Which parameters the laxity of a knee depends on."""

from collections.abc import Sequence

import numpy as np

from identknee.calibrate.starts import load_start
from identknee.identify.sensitivity import DEFAULT_DRAWS, Box, Method, Sensitivity, box_around
from identknee.identify.sensitivity import sensitivity as analysed
from identknee.laxity.named_trials import TrialsLike, read_tests
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.laxity.trial_words import LaxityGroup, laxity_groups
from identknee.model.of_tests import model_of_tests
from identknee.model.quantities import LaxityOutputs
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.files import PathLike, digest
from identknee.runs.findings import finding
from identknee.runs.workers import Workers
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.verb import LaxityLike, Run, SubjectLike, not_deciding, verb
from identknee.verbs.warming import warm_up


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
@not_deciding("method", "samples")
def sensitivity(
    run: Run,
    subject: SubjectLike,
    data: LaxityLike | None = None,
    *,
    protocol: TrialsLike | None = None,
    method: Method = "sobol",
    samples: int | None = None,
    posterior: PathLike | None = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> GlobalSensitivity:
    """Which parameters the laxity of a knee depends on.

    Outputs are grouped by coordinate, flexion angle and kind of load; failures to converge are an
    output of their own.

    Parameters
    ----------
    subject
        A knee, its folder, or the name of one that comes with identknee.
    data
        Measured laxity whose trials are meant, its CSV file, or the name of a subject that comes
        with one.
    protocol
        The trials where there are no data: a protocol, the name of one, its TOML file, or a laxity
        table; ``"seed63"`` if None.
    method
        ``"morris"`` and ``"sobol"`` vary parameters independently in a box around the start; the
        others take draws of a posterior, or draws from the box.
    samples
        Trajectories (256 if None), blocks (1,024) or draws (2,048, at most so many of the
        posterior).
    posterior
        Folder of results of a sample.
    start
        Middle of the box: ``"subject"``, ``"IG1"`` to ``"IG4"``, or a TOML file.
    fixed
        Names of parameters held at the start.
    out
        Folder for the results, and for the work of a run that was stopped, which the same call
        resumes; nothing is written if None.
    seed
        Seed of all random numbers.
    workers
        Processes to work with, or the address of a dask scheduler; results are the same.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do. That no simulation has all
        predictions is no error: the answer says it in `failure`.
    """
    if run.measured is not None and protocol is not None:
        raise ValueError(
            "the trials are those of DATA.csv or those of --protocol; give one of the two"
        )
    planned = "seed63" if protocol is None else protocol
    tests = read_tests(planned) if run.measured is None else run.measured
    outputs = _outputs(run.knee, tests, start, fixed)
    over = _where(run, outputs, posterior, samples)
    warm_up(run.knee, outputs.model.protocol)
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
    return GlobalSensitivity(analysis=found, laxity_groups=tuple(groups.values()), findings=nothing)


def _outputs(
    knee: Knee, tests: Protocol | Laxity, start: str, fixed: Sequence[str] | None
) -> LaxityOutputs:
    model = model_of_tests(knee, tests)
    held = {*(fixed or ()), *model.parameters.nuisance_names}
    free = model.parameters.with_fixed(tuple(held), load_start(start, model.parameters))
    if free.parameters.n < 2:
        raise ValueError(
            "a sensitivity analysis needs at least two parameters that vary; fix fewer"
        )
    return LaxityOutputs(
        model=model,
        groups=tuple(x.name for x in laxity_groups(model.protocol)),
        free=free,
        zero=tests.zero if isinstance(tests, Laxity) else "absolute",
    )


def _where(
    run: Run, outputs: LaxityOutputs, posterior: PathLike | None, samples: int | None
) -> Box | Array:
    """The box, or draws of a posterior, whose number decides which they are."""
    if posterior is None:
        middle = outputs.free.restrict(outputs.free.fixed_values)
        return box_around(outputs.parameters, middle)
    # xarray takes longer to load than most mistakes take.
    from identknee.verbs.posterior_draws import posterior_draws

    draws = posterior_draws(posterior, outputs.parameters.names, samples or DEFAULT_DRAWS)
    run.also_decide(draws=digest(np.ascontiguousarray(draws).tobytes()))
    return draws
