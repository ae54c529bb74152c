"""The paper's question on the reference knee, and the answer, in about a minute."""

import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.fit import Fit, fit_many, load_start
from identknee.calibrate.problem import Problem, ProblemAround
from identknee.identify.optimum import best_fit
from identknee.identify.profile.profile import profile_parameters
from identknee.identify.profile.result import Profile
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise, laxity_rmse, write_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import OF_PARAMETER, Array, IntArray, array, declared, derived, entry
from identknee.runs.executors import Executor, executor_of, serial, threads
from identknee.runs.record import Outcome
from identknee.subject.folder import read_subject
from identknee.verbs.options import REFERENCE, OutOption, Seed, Workers, option
from identknee.verbs.simulate import LAXITY_FILE, SimulatedLaxity, simulated
from identknee.verbs.values import by_ligament
from identknee.verbs.verb import Run, verb, warm_up


@declared
class ParameterError:
    """Absolute differences of a parameter set from another, over the ligaments."""

    stiffness_kN: Array = array("Error of the stiffness of each ligament", "ligament", unit="kN")  # noqa: N815 - the unit
    strain_pct: Array = array("Error of its reference strain", "ligament", unit="%")

    @property
    def mean_kN(self) -> float:  # noqa: N802 - the unit
        """Mean over the ligaments [kN]."""
        return float(self.stiffness_kN.mean())

    @property
    def mean_pct(self) -> float:
        """Mean over the ligaments [%]."""
        return float(self.strain_pct.mean())


def parameter_error(theta: ArrayLike, truth: ArrayLike) -> ParameterError:
    """Absolute differences of `theta` from `truth`, both stiffnesses first, shape ``(2 m,)``.

    Raises
    ------
    ValueError
        If the shapes differ or the length is odd.

    Examples
    --------
    >>> error = parameter_error([10.5, 18.0, 8.0, -4.5], [10.0, 18.0, 8.0, -4.0])
    >>> error.mean_kN, error.mean_pct
    (0.25, 0.25)
    """
    difference = np.abs(np.asarray(theta, float) - np.asarray(truth, float))
    if difference.ndim != 1 or difference.size % 2:
        raise ValueError(
            "theta must hold a stiffness and a reference strain for every ligament, "
            f"got shape {difference.shape}"
        )
    half = difference.size // 2
    return ParameterError(stiffness_kN=difference[:half], strain_pct=difference[half:])


STARTS = ("IG1", "IG2", "IG3", "IG4")
SHORT_SETTINGS = "short settings"
NOISE_MM, NOISE_DEG = 0.5, 0.5
Made = TypeVar("Made")


@declared
class StartFits:
    """What one method made of one start, in one run or several."""

    start: str = entry("Name of the start")
    method: str = entry("The optimizer")
    ends: tuple[Outcome, ...] = entry("How each run ended")
    theta: Array = array("Parameters that each run ended at", "run", "parameter", unit=OF_PARAMETER)
    error_kN: Array = array(  # noqa: N815 - the unit
        "Mean absolute error of the stiffnesses of each run", "run", unit="kN"
    )
    error_pct: Array = array(
        "Mean absolute error of the reference strains of each run", "run", unit="%"
    )
    rmse_mm: Array = array("Error of the translations of each run", "run", unit="mm")
    rmse_deg: Array = array("Error of the rotations of each run", "run", unit="deg")
    simulations: IntArray = array("Simulations made by each run", "run", dtype=int)
    search_seconds: Array = array("Time taken by each run", "run", unit="s")

    @property
    @derived("Number of runs", unit="1")
    def n_runs(self) -> int:
        return len(self.ends)

    @property
    @derived("How many runs ended in which way", unit="1")
    def outcomes(self) -> dict[str, int]:
        return dict(Counter(x.value for x in self.ends))

    @property
    @derived("Medians of both errors over the runs, as kN and pct")
    def error(self) -> dict[str, float]:
        return {"kN": _median(self.error_kN), "pct": _median(self.error_pct)}

    @property
    @derived("Medians of both errors of the laxity over the runs, as mm and deg")
    def rmse(self) -> dict[str, float]:
        return {"mm": _median(self.rmse_mm), "deg": _median(self.rmse_deg)}

    @property
    @derived("Median number of simulations of a run", unit="1")
    def n_simulations(self) -> float:
        return _median(self.simulations)

    @property
    @derived("Median time of a run", unit="s")
    def seconds(self) -> float:
        return _median(self.search_seconds)


@declared
class Demonstration(SimulatedLaxity):
    """Known parameters, fits from the paper's starts, and profiles from noisy data."""

    settings: str = entry("What kind of settings it was done with")
    starts: tuple[StartFits, ...] = entry(
        "The fits by method and start", rows="search", group="fits"
    )
    noise: Mapping[str, float] = entry("Noise of the profiled data, as mm and deg")
    profiles: Mapping[str, Profile] = entry(
        "Profile of each parameter by its name", rows="quantity", group="profile"
    )

    @property
    @derived("The parameters that made the data, by ligament and quantity", unit=OF_PARAMETER)
    def truth(self) -> dict[str, dict[str, float]]:
        return by_ligament(self.parameter_set)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _InterruptibleProblem(ProblemAround):
    """A problem that ends its fits on request, so that Ctrl-C does not wait for threads."""

    is_stopped: threading.Event = field(default_factory=threading.Event)

    @override
    def residuals(self, theta: Array) -> Array:
        if self.is_stopped.is_set():
            raise KeyboardInterrupt
        return self.problem.residuals(theta)


@verb
def demo(
    run: Run,
    *,
    runs: Annotated[int, option("Runs of the Complex method from each start.", least=1)] = 2,
    budget: Annotated[int, option("Largest number of simulations per run.", least=1)] = 2500,
    seed: Seed = 0,
    workers: Workers = 2,
    **_: Unpack[OutOption],
) -> Demonstration:
    """The paper's question on the reference knee, and the answer.

    Does a good fit mean that the parameters are right? Laxity of known parameters is simulated in
    63 trials. It is fitted from the four initial guesses of the paper, by its Complex method and
    by least squares. Then noise is added, and profiles show within what limits the data determine
    each parameter. The settings are short, with a few runs per start. Open report.html in a
    browser to see the answer.
    """
    knee = read_subject(REFERENCE)
    protocol = load_protocol("seed63")
    warm_up(knee, protocol)
    run.start_clock()
    model = LaxityModel(knee=knee, protocol=protocol)
    prediction = model.predict(model.parameters.center, derivatives=False)
    laxity = Laxity(protocol=protocol, coordinates=prediction.coordinates)
    exact = LaxityResiduals(model=model, laxity=laxity)
    with executor_of(workers, threads) as executor:
        starts = (
            *_fits(exact, "complex", runs, (seed, budget), executor),
            *_fits(exact, "least-squares", 1, (seed, budget), serial),
        )
        profiles = _profiles(model, laxity, seed, executor)
    if run.out is not None:
        write_laxity(laxity, run.out / LAXITY_FILE)
    return Demonstration(
        **simulated(model, prediction),
        settings=SHORT_SETTINGS,
        starts=starts,
        noise={"mm": NOISE_MM, "deg": NOISE_DEG},
        profiles={x.name: x for x in profiles},
    )


def start_fits(
    start: str, fits: Sequence[Fit], truth: Array, problem: LaxityResiduals
) -> StartFits:
    """The errors of fits from one start."""
    errors = [parameter_error(fit.theta, truth) for fit in fits]
    rmses = [laxity_rmse(problem.model.simulate(fit.theta), problem.laxity) for fit in fits]
    return StartFits(
        start=start,
        method=fits[0].method,
        ends=tuple(x.outcome for x in fits),
        theta=np.array([x.theta for x in fits]),
        error_kN=np.array([x.mean_kN for x in errors]),
        error_pct=np.array([x.mean_pct for x in errors]),
        rmse_mm=np.array([x.mm for x in rmses]),
        rmse_deg=np.array([x.deg for x in rmses]),
        simulations=np.array([x.n_simulations for x in fits]),
        search_seconds=np.array([x.seconds for x in fits]),
    )


def _fits(
    problem: LaxityResiduals, method: str, runs: int, settings: tuple[int, int], executor: Executor
) -> list[StartFits]:
    points = [load_start(name, problem.parameters) for name in STARTS for _ in range(runs)]
    seed, budget = settings
    fits = _with_interrupt(
        problem,
        lambda x: fit_many(x, points, seed=seed, executor=executor, method=method, budget=budget),
    )
    truth = problem.parameters.center
    return [
        start_fits(name, fits[i * runs : (i + 1) * runs], truth, problem)
        for i, name in enumerate(STARTS)
    ]


def _profiles(
    model: LaxityModel, laxity: Laxity, seed: int, executor: Executor
) -> tuple[Profile, ...]:
    noisy = add_noise(laxity, sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=seed)

    def profiled(problem: Problem) -> tuple[Profile, ...]:
        best = best_fit(problem, seed=seed, executor=executor)
        return profile_parameters(problem, best.theta, executor=executor)

    return _with_interrupt(LaxityResiduals(model=model, laxity=noisy, weighting="noise"), profiled)


def _with_interrupt(problem: Problem, work: Callable[[Problem], Made]) -> Made:
    """What `work` makes of the problem; where it is interrupted its threads end soon."""
    interruptible = _InterruptibleProblem(problem=problem)
    try:
        return work(interruptible)
    except BaseException:
        interruptible.is_stopped.set()
        raise


def _median(values: Array | IntArray) -> float:
    return float(np.median(values))
