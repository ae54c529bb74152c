"""`identknee demo`: the paper's question on the reference knee, and the answer, in a minute."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import identknee as ik
from identknee.calibrate.scales import STIFFNESS_UNIT
from identknee.cli.command import Json, Out, Seed, Workers, nested, show
from identknee.cli.lazily import knee_digest, warm_up
from identknee.cli.report import write_report
from identknee.runs.executors import Executor, serial, threads
from identknee.runs.files import prepare_folder, write_atomically
from identknee.runs.record import record

if TYPE_CHECKING:
    from identknee.report.starts import StartRow
    from identknee.runs.arrays import Array

STARTS = ("IG1", "IG2", "IG3", "IG4")
SHORT_SETTINGS = "short settings"
NOISE_MM, NOISE_DEG = 0.5, 0.5
PAGE = "report.html"

Runs = Annotated[int, typer.Option(min=1, help="Runs of Complex from each start.")]
Budget = Annotated[int, typer.Option(min=1, help="Simulations allowed in each run.")]


def demo(
    context: typer.Context,
    runs: Runs = 2,
    budget: Budget = 2500,
    out: Out = Path("identknee-demo"),
    seed: Seed = 0,
    workers: Workers = 2,
    as_json: Json = False,
) -> None:
    """The paper's question and its answer, in about a minute.

    Laxity of known parameters is simulated (63 trials) and fitted from the paper's four initial
    guesses, by its Complex method and by least squares: does a good fit mean right parameters?
    Then noise is added, and profiles say within what limits the data determine each parameter.
    Short settings: a few runs a start. All of it ends in report.html, to open in a browser.
    """
    prepare_folder(out)
    knee, protocol = ik.read_subject("reference"), ik.load_protocol("seed63")
    recording = record("demo", context.params, {"subject": knee_digest(knee)}, seed)
    warm_up(knee, protocol)
    simulation = ik.simulate(knee, protocol)
    fit_all = partial(_fit_all, simulation, seed=seed, budget=budget)
    _say(
        f"Reference knee, {protocol.n} trials, noise-free. {SHORT_SETTINGS.capitalize()}.", as_json
    )
    _say(f"Fitting from {', '.join(STARTS)}: Complex ({runs} runs each), least squares.", as_json)
    with threads(workers) as executor:
        rows = [
            *fit_all("complex", runs, executor=executor),
            *fit_all("least-squares", 1, executor=serial),
        ]
        _say(f"Profiling with noise of {NOISE_MM:g} mm and {NOISE_DEG:g} deg.", as_json)
        profiles = _profile_all(simulation, seed=seed, executor=executor)
    summary = _write(out, rows, profiles, simulation, recording.finish())
    write_report(out, out / PAGE)
    show(summary, _lines(rows, profiles, out), as_json=as_json)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Interruptible:
    """A problem that ends its fits once it is told to, so that Ctrl-C does not wait for threads."""

    problem: "ik.calibrate.Problem"
    is_stopped: threading.Event = field(default_factory=threading.Event)

    @property
    def parameters(self) -> "ik.Parameters":
        return self.problem.parameters

    def residuals(self, theta: "Array") -> "Array":
        if self.is_stopped.is_set():
            raise KeyboardInterrupt
        return self.problem.residuals(theta)

    def jacobian(self, theta: "Array") -> "Array":
        return self.problem.jacobian(theta)


def _fit_all(
    simulation: "ik.model.Simulation",
    method: str,
    runs: int,
    *,
    seed: int,
    budget: int,
    executor: Executor,
) -> "list[StartRow]":
    """Rows of all starts for one method."""
    from identknee.report.starts import start_row

    problem = ik.LaxityResiduals(model=simulation.model, laxity=simulation.laxity)
    points = [ik.load_start(name, problem.parameters) for name in STARTS for _ in range(runs)]
    interruptible = _Interruptible(problem=problem)
    try:
        fits = ik.calibrate.fit_many(
            interruptible, points, seed=seed, executor=executor, method=method, budget=budget
        )
    except BaseException:
        interruptible.is_stopped.set()
        raise
    truth = simulation.prediction.theta
    return [
        start_row(name, fits[i * runs : (i + 1) * runs], truth, problem.model, simulation.laxity)
        for i, name in enumerate(STARTS)
    ]


def _profile_all(
    simulation: "ik.model.Simulation", *, seed: int, executor: Executor
) -> "tuple[ik.Profile, ...]":
    """Profiles of all parameters from noisy data."""
    noisy = ik.add_noise(simulation.laxity, sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=seed)
    problem = ik.LaxityResiduals(model=simulation.model, laxity=noisy, weighting="noise")
    interruptible = _Interruptible(problem=problem)
    try:
        best = ik.identify.best_fit(interruptible, seed=seed, executor=executor)
        return ik.profile_parameters(interruptible, best.theta, executor=executor)
    except BaseException:
        interruptible.is_stopped.set()
        raise


def _write(
    out: Path,
    rows: "Sequence[StartRow]",
    profiles: "Sequence[ik.Profile]",
    simulation: "ik.model.Simulation",
    finished: Any,
) -> dict[str, Any]:
    from identknee.report.groups import simulation_groups
    from identknee.report.picture import png
    from identknee.report.profile_figures import profiles_figure
    from identknee.report.profile_groups import profile_groups, profile_summary
    from identknee.report.result_files import write_result
    from identknee.report.starts import starts_dataset
    from identknee.report.starts_figure import starts_figure

    ik.write_laxity(simulation.laxity, out / "laxity.csv")
    fits = starts_dataset(rows)
    write_atomically(out / "starts.png", png(starts_figure(fits)))
    write_atomically(out / "profiles.png", png(profiles_figure(profiles)))
    write_atomically(out / "knee.png", png(ik.scene(simulation.model.knee)))
    names = simulation.model.parameters.names
    summary = {
        "settings": SHORT_SETTINGS,
        "subject": simulation.model.knee.name,
        "protocol": simulation.model.protocol.name,
        "truth": nested(dict(zip(names, simulation.prediction.theta, strict=True))),
        "starts": [row.to_dict() for row in rows],
        "noise": {"mm": NOISE_MM, "deg": NOISE_DEG},
        "profiles": {profile.name: profile_summary(profile) for profile in profiles},
    }
    groups = {
        **simulation_groups(simulation, simulation.laxity),
        "fits": fits,
        **profile_groups(profiles, names),
    }
    return write_result(out, summary, groups, finished)


def _lines(rows: "Sequence[StartRow]", profiles: "Sequence[ik.Profile]", out: Path) -> list[str]:
    from identknee.report.page.search_sentences import exact_fit, misleading_fit
    from identknee.report.profile_table import profile_table
    from identknee.report.starts import starts_table

    said = [x.to_dict() for x in rows]
    searches = [x for x in said if x["method"] == "complex"]
    descents = [x for x in said if x["method"] == "least-squares"]
    return [
        "",
        *starts_table(rows),
        "(medians over the runs)",
        "",
        misleading_fit(max(searches, key=lambda x: float(x["error"]["kN"]))),
        exact_fit(descents),
        "",
        *profile_table(profiles),
        _what_profiles_show(profiles),
        f"The table ({SHORT_SETTINGS}: {searches[0]['n_runs']} runs a start), figures, data: {out}",
        f"Open in a browser: {out / PAGE}",
    ]


def _what_profiles_show(profiles: "Sequence[ik.Profile]") -> str:
    closed = [x for x in profiles if x.lower is not None and x.upper is not None]
    known = (
        f"With noise of {NOISE_MM:g} mm and {NOISE_DEG:g} deg, {len(closed)} of {len(profiles)} "
        "parameters have a 95 % interval that closes"
    )
    stiffness = [x for x in closed if x.name.endswith(STIFFNESS_UNIT)]
    if not stiffness:
        return f"{known}."
    widest = max(stiffness, key=_width)
    return f"{known}; the widest of the stiffnesses, {widest.name}, leaves {_width(widest):.1f} kN."


def _width(profile: "ik.Profile") -> float:
    if profile.lower is None or profile.upper is None:
        return float("inf")
    return profile.upper - profile.lower


def _say(line: str, as_json: bool) -> None:
    if not as_json:
        typer.echo(line, err=True)
