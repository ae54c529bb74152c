"""A data set with a hidden effect, drawn by its seed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from identknee.blind import energy
from identknee.blind.conditions import (
    NO_ERRORS,
    STANDARD,
    Conditions,
    knee_with_errors,
    load_errors,
    true_errors,
    with_load_errors,
)
from identknee.blind.effects import EFFECTS, HISTORY, LISTED, UNLISTED
from identknee.blind.experiment import (
    REFERENCE_STRAIN,
    STIFFNESS,
    Experiment,
    ExperimentRun,
    experiment_of,
    parameter_derivatives,
    run_experiment,
    tensions,
)
from identknee.blind.hidden import Hidden, Scene, anatomical_sites
from identknee.blind.truth import Truth, write_truth
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.table import Laxity, add_noise, write_laxity
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry
from identknee.runs.errors import suggestion
from identknee.runs.files import PathLike, prepare_folder
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface

# Least distance of a contact from a rim [mm]: beyond the rim the surface is unknown.
MARGIN = 3.0
REACH = 0.5  # distance from the femur within which tibial points may touch [mm]


@declared
class Rims:
    """Rims of the surfaces."""

    femur: cKDTree = entry("Points of the femoral rim in the femur's frame")
    tibia: tuple[tuple[cKDTree, cKDTree], ...] = entry(
        "Points of the rim of each tibial surface in the tibia's frame, with all its vertices"
    )


def rims_of(knee: Knee) -> Rims:
    """The rims of a knee's articular surfaces."""
    return Rims(
        femur=cKDTree(knee.femur_frame.to_local(_rim(knee.femur))),
        tibia=tuple(
            (
                cKDTree(knee.tibia_frame.to_local(_rim(x))),
                cKDTree(knee.tibia_frame.to_local(x.vertices)),
            )
            for x in knee.tibia
        ),
    )


def contact_stays_inside(experiment: Experiment, run: ExperimentRun, rims: Rims) -> bool:
    """Whether the centre of every contact of every trial is well inside both surfaces."""
    return all(_is_inside(experiment, R, t, rims) for R, t in run.poses)


def _rim(surface: Surface) -> Array:
    return np.asarray(surface.vertices[np.unique(surface.boundary_edges)])


def _is_inside(experiment: Experiment, R: Array, t: Array, rims: Rims) -> bool:
    knee = experiment.arrays()
    listed = energy.candidates(R, t, knee.surface, knee.field, REACH)
    touching = np.empty(len(experiment.points), np.int64)
    _, n = energy.energy_of(R, t, np.zeros(5), knee, listed, np.zeros(5), touching)
    points = experiment.points[touching[:n]]
    weight = experiment.areas[touching[:n]]
    # A point belongs to the nearest tibial surface.
    distances = np.array([sheet.query(points)[0] for _, sheet in rims.tibia])
    for index, (rim, _) in enumerate(rims.tibia):
        own = distances.argmin(axis=0) == index
        if not own.any():
            continue
        middle = np.average(points[own], axis=0, weights=weight[own])
        if rim.query(middle)[0] < MARGIN or rims.femur.query(R @ middle + t)[0] < MARGIN:
            return False
    return True


# Share of the chi-square that a step may still gain, and share by which a signal may miss.
FIT_TOLERANCE = 1e-3
SIGNAL_TOLERANCE = 0.02
FIT_STEPS = 25
AMPLITUDE_STEPS = 12
LEAST_STIFFNESS_KN = 0.05
# Share of the largest amplitude where the search begins, and largest factor of one change.
FIRST_SHARE = 0.05
LARGEST_FACTOR = 6.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """Errors of a trial: standard deviations [mm], [deg] and the correlation within it."""

    sd_mm: float
    sd_deg: float
    correlation: float

    def whitened(self, values: Array) -> Array:
        """Values ``(n, 5, ...)`` as combinations whose errors are independent with variance 1."""
        shared = np.full((5, 5), self.correlation)
        np.fill_diagonal(shared, 1.0)
        sd = np.array([self.sd_mm] * 3 + [self.sd_deg] * 2)
        inverse = np.linalg.inv(np.linalg.cholesky(sd[:, None] * shared * sd))
        return np.asarray(np.einsum("ij,nj...->ni...", inverse, values))


@declared
class LigamentFit:
    """The best fit of the ligament parameters alone."""

    theta: Array = entry("Stiffnesses [kN], then reference strains [%]")
    run: ExperimentRun = entry("The simulated experiment at these parameters")
    signal: float = entry("Root of the remaining chi-square")


@declared
class SizedAmplitude:
    """The amplitude that gives a wanted signal."""

    amplitude: float = entry("Amplitude in the effect's unit, > 0")
    signal: float = entry("Signal at this amplitude")
    is_largest: bool = entry(
        "Whether the search ended at the largest plausible amplitude short of the wanted signal"
    )


def unexplained_norm(slopes: Array, change: Array, noise: Noise) -> float:
    """Norm of the part of a `change` (n, 5) that `slopes` (n, 5, p) cannot fit, in noise units."""
    columns = noise.whitened(slopes).reshape(-1, slopes.shape[2])
    white = noise.whitened(change).ravel()
    share = np.linalg.lstsq(columns, white, rcond=None)[0]
    return float(np.linalg.norm(white - columns @ share))


def base_fit(base: Experiment, target: Array, noise: Noise, start: LigamentFit) -> LigamentFit:
    """Best fit of `base`, an experiment without effect, to coordinates `target` ``(n, 5)``.

    Damped Gauss-Newton from a fit nearby. A step is rejected if it fits worse or leaves a trial
    without equilibrium.
    """
    m = len(start.theta) // 2
    theta, run = start.theta, start.run
    residual = noise.whitened(run.coordinates - target).ravel()
    damping = 1e-3
    for _ in range(FIT_STEPS):
        slopes = noise.whitened(parameter_derivatives(base.with_theta(theta), run, m)).reshape(
            -1, 2 * m
        )
        normal, slope = slopes.T @ slopes, slopes.T @ residual
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), slope)
        new = theta + step
        new[:m] = np.maximum(new[:m], LEAST_STIFFNESS_KN)
        new_run = run_experiment(base.with_theta(new), run)
        gained = -1.0
        if new_run.is_complete:
            new_residual = noise.whitened(new_run.coordinates - target).ravel()
            gained = float(residual @ residual - new_residual @ new_residual)
        if gained < 0.0:
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e6:
                break
            continue
        theta, run, residual = new, new_run, new_residual
        damping *= 0.1
        if gained <= FIT_TOLERANCE * max(1.0, float(residual @ residual)):
            break
    return LigamentFit(theta=theta, run=run, signal=float(np.sqrt(residual @ residual)))


def amplitude_for_signal(
    projected: Callable[[float], float | None],
    fitted: Callable[[float], float | None],
    wanted: float,
    largest: float,
) -> SizedAmplitude | None:
    """The amplitude whose signal is `wanted`, at most `largest`; None where a trial fails.

    Parameters
    ----------
    projected, fitted
        Signal at an amplitude, by the linear model of the parameters and by their best fit, which
        takes longer; None where a trial has no equilibrium.
    wanted, largest
        Signal to reach, and the end of the search.
    """
    found = _searched(projected, wanted, FIRST_SHARE * largest, largest)
    return None if found is None else _searched(fitted, wanted, found.amplitude, largest)


def _searched(
    signal_of: Callable[[float], float | None], wanted: float, amplitude: float, largest: float
) -> SizedAmplitude | None:
    known: list[tuple[float, float]] = []
    for _ in range(AMPLITUDE_STEPS):
        signal = signal_of(amplitude)
        if signal is None:
            return None
        known.append((amplitude, signal))
        is_largest = signal < wanted and amplitude >= largest
        if is_largest or abs(signal / wanted - 1.0) < SIGNAL_TOLERANCE:
            return SizedAmplitude(amplitude=amplitude, signal=signal, is_largest=is_largest)
        amplitude = min(largest, _next(known, wanted))
    return SizedAmplitude(amplitude=known[-1][0], signal=known[-1][1], is_largest=False)


def _next(known: list[tuple[float, float]], wanted: float) -> float:
    """The next amplitude to try, if the signal is a power of the amplitude."""
    below = [x for x in known if x[1] < wanted]
    above = [x for x in known if x[1] >= wanted]
    last = known[-1]
    power = 1.0
    if len(known) > 1 and known[-2][0] != last[0] and known[-2][1] > 0.0 < last[1]:
        power = np.log(last[1] / known[-2][1]) / np.log(last[0] / known[-2][0])
        power = float(np.clip(power, 0.4, 3.0))
    guess = last[0] * float(
        np.clip((wanted / max(last[1], 1e-6)) ** (1.0 / power), 1 / LARGEST_FACTOR, LARGEST_FACTOR)
    )
    if below and above:
        low, high = max(below)[0], min(above)[0]
        if low < high and not low < guess < high:
            guess = float(np.sqrt(low * high))
    return guess


RANDOM = "random"
# Shares of the cases of "random" without an effect and with an unlisted one; the rest have a listed
# effect.
NULL_SHARE, UNLISTED_SHARE = 0.15, 0.15
SD, CORRELATION = 0.3, 0.3  # mm and deg, and within a trial
# Share of the cases whose errors have heavy tails: Student's t with so many degrees of freedom.
HEAVY_SHARE, HEAVY_DEGREES = 0.1, 5.0
# Range of the stated standard deviation over the true one.
STATED_RANGE = (0.8, 1.2)
# Share of the cases that state the order of their trials although no effect depends on it.
ORDER_SHARE = 0.3
MOST_DRAWS = 40
# Draws without equilibrium after which the errors of the knee are drawn again too.
DRAWS_A_KNEE = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlindCase:
    """Data with a hidden effect.

    Attributes
    ----------
    laxity
        The data given to the diagnosis: noisy, with the stated standard deviations.
    truth
        The hidden effects and true parameters.
    noise_free
        The data without errors.
    tensions
        True tension of each ligament in each trial [N], shape ``(n, m)``.
    """

    laxity: Laxity
    truth: Truth
    noise_free: Laxity
    tensions: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """A draw of parameters and effects, and its experiment, with equilibrium in every trial."""

    theta: Array
    own: Experiment
    run: ExperimentRun
    hidden: tuple[Hidden, ...]
    sizes: tuple[float, ...]
    signal: float
    is_largest: bool


def blind_case(
    knee: Knee,
    *,
    seed: int,
    effect: str | Sequence[str] | None = RANDOM,
    signal: float | None = None,
    amplitude: float | None = None,
    protocol: Protocol | None = None,
    conditions: Conditions = STANDARD,
) -> BlindCase:
    """A data set of `knee` with a hidden effect; the same seed gives the same numbers.

    True ligament parameters are drawn around the subject's, the insertions of a missing structure
    around its anatomical sites. The draw is repeated if a trial has no equilibrium or jumps to
    another one, or if contact comes close to a rim.

    Parameters
    ----------
    knee
        The subject; its surfaces and insertions are also those of the model under test.
    seed
        Seed of everything random, >= 0.
    effect
        A name in `EFFECTS`, several of them, ``"random"`` for one drawn by the seed, which may also
        draw none, or None for no effect.
    signal
        Root of the chi-square of the best fit of the ligament parameters alone to the noise-free
        data, in units of the true noise. Each effect alone is sized to give this signal. If None,
        sizes are drawn from those of the literature.
    amplitude
        Size of the effect in its own unit, in place of a signal, as to repeat a case under another
        protocol.
    protocol
        The trials; ``seed63`` where None.
    conditions
        Distributions of true parameters, insertions, contact, and errors of geometry and readings.

    Raises
    ------
    ValueError
        If an effect is unknown or given twice, the signal is not positive, or no draw has an
        equilibrium in every trial.
    """
    protocol = load_protocol("seed63") if protocol is None else protocol
    if signal is not None and not 0.0 < signal < np.inf:
        raise ValueError(f"the signal must be greater than 0 and finite, got {signal:g}")
    streams = [np.random.default_rng(x) for x in np.random.SeedSequence(seed).spawn(7)]
    names = _names(effect, streams[0])
    order, is_unloading = _history(protocol, streams[1])
    exponent = float(streams[4].uniform(*conditions.exponents))
    base = experiment_of(knee, protocol, exponent)
    scene = Scene(
        places=anatomical_sites(knee),
        n_lines=len(knee.ligaments),
        start=base.start,
        load_Nm=protocol.loads[:, :2],
        order=order,
        is_unloading=is_unloading,
        conditions=conditions,
    )
    noise = Noise(sd_mm=SD, sd_deg=SD, correlation=CORRELATION)
    actual, off = knee, NO_ERRORS
    wanted, redraws, found = (noise, signal, amplitude), 0, None
    while found is None and redraws < MOST_DRAWS:
        if redraws % DRAWS_A_KNEE == 0 and conditions.has_stated_errors:
            actual = knee_with_errors(knee, conditions, streams[6])
            off = load_errors(conditions, streams[6])
            base = with_load_errors(experiment_of(actual, protocol, exponent), off)
            scene = replace(scene, places=anatomical_sites(actual), start=base.start)
        found = _drawn(base, names, scene, wanted, streams[2])
        if found is None or not contact_stays_inside(found.own, found.run, rims_of(actual)):
            found, redraws = None, redraws + 1
    if found is None:
        raise ValueError(
            f"{MOST_DRAWS} draws of {' and '.join(names) or 'parameters'} left a trial without "
            f"equilibrium on the knee {knee.name}; choose another effect, a smaller signal or "
            "smaller loads"
        )
    tells_order = bool(HISTORY & set(names)) or streams[1].random() < ORDER_SHARE
    exact = Laxity(
        protocol=protocol,
        coordinates=found.run.coordinates,
        order=order if tells_order else None,
        phase=_phase(protocol, is_unloading) if tells_order else None,
        comments=(f"blind case, seed {seed}",),
    )
    laxity, facts = _noisy(exact, noise, streams[3])
    remounting = conditions.remounting(protocol.flexion_deg, streams[5])
    laxity = replace(laxity, coordinates=laxity.coordinates + remounting)
    facts |= {"contact_exponent": exponent, "largest_remounting": float(np.abs(remounting).max())}
    truth = _truth(actual, seed, found, {**facts, "redraws": redraws, "wanted_signal": signal})
    return BlindCase(
        laxity=laxity,
        truth=replace(truth, stated_errors=true_errors(knee, actual, off)),
        noise_free=exact,
        tensions=tensions(found.own, found.run, scene.n_lines),
    )


def _names(effect: str | Sequence[str] | None, generator: np.random.Generator) -> tuple[str, ...]:
    if effect is None:
        return ()
    if effect == RANDOM:
        share = generator.random()
        if share < NULL_SHARE:
            return ()
        pool = UNLISTED if share < NULL_SHARE + UNLISTED_SHARE else LISTED
        return (str(generator.choice(list(pool))),)
    names = (effect,) if isinstance(effect, str) else tuple(effect)
    for name in names:
        if name not in EFFECTS:
            raise ValueError(f"no effect is called {name!r}. {suggestion(name, EFFECTS)}")
        if names.count(name) > 1:
            raise ValueError(f"the effect {name} is given twice; give it once")
    return names


def _history(protocol: Protocol, generator: np.random.Generator) -> tuple[IntArray, BoolArray]:
    order = np.asarray(generator.permutation(protocol.n) + 1, np.int64)
    return order, generator.random(protocol.n) < 0.5


def _phase(protocol: Protocol, is_unloading: BoolArray) -> tuple[str, ...]:
    return tuple(
        "" if rests else "unloading" if down else "loading"
        for rests, down in zip(protocol.is_unloaded, is_unloading, strict=True)
    )


def _drawn(
    base: Experiment,
    names: Sequence[str],
    scene: Scene,
    wanted: tuple[Noise, float | None, float | None],
    generator: np.random.Generator,
) -> _Found | None:
    """A draw of parameters and sized effects; None if a trial has no equilibrium."""
    noise, signal, amplitude = wanted
    theta = _theta(base, scene, generator)
    if theta is None:
        return None
    hidden = tuple(EFFECTS[name](scene, generator) for name in names)
    own = base.with_theta(theta)
    run = run_experiment(own)
    if not run.is_complete:
        return None
    null = LigamentFit(theta=theta, run=run, signal=0.0)
    sizes, is_largest = [], False
    for x in hidden:
        size = _usual_size(x, scene, generator)
        if amplitude is not None:
            size = abs(amplitude)
        elif signal is not None:
            scaled = _sized(x, own, null, (noise, signal))
            if scaled is None or (scaled[1] and x.name in UNLISTED):
                return None
            size, reached_end = scaled
            is_largest |= reached_end
        sizes.append(x.sign * size)
    if not hidden:
        return _Found(
            theta=theta, own=own, run=run, hidden=(), sizes=(), signal=0.0, is_largest=False
        )
    for x, size in zip(hidden, sizes, strict=True):
        own = x.apply(own, size)
    run = run_experiment(own)
    if not run.is_complete:
        return None
    fit = base_fit(base, run.coordinates, noise, null)
    return _Found(
        theta=theta,
        own=own,
        run=run,
        hidden=hidden,
        sizes=tuple(sizes),
        signal=fit.signal,
        is_largest=is_largest,
    )


def _sized(
    hidden: Hidden, own: Experiment, null: LigamentFit, wanted: tuple[Noise, float]
) -> tuple[float, bool] | None:
    """Amplitude > 0 for a signal, and whether it is the largest plausible one."""
    noise, signal = wanted

    slopes = parameter_derivatives(own, null.run, len(null.theta) // 2)
    last = null

    def run_at(amplitude: float) -> ExperimentRun | None:
        run = run_experiment(hidden.apply(own, hidden.sign * amplitude), null.run)
        return run if run.is_complete else None

    def projected(amplitude: float) -> float | None:
        run = run_at(amplitude)
        if run is None:
            return None
        return unexplained_norm(slopes, run.coordinates - null.run.coordinates, noise)

    def fitted(amplitude: float) -> float | None:
        nonlocal last
        run = run_at(amplitude)
        if run is None:
            return None
        last = base_fit(own, run.coordinates, noise, last)
        return last.signal

    scaled = amplitude_for_signal(projected, fitted, signal, hidden.largest)
    return None if scaled is None else (scaled.amplitude, scaled.is_largest)


def _usual_size(hidden: Hidden, scene: Scene, generator: np.random.Generator) -> float:
    """Amplitude > 0 drawn from the conditions, or evenly in its logarithm between its limits."""
    spread = scene.conditions.amplitudes.get(hidden.name)
    if spread is None:
        share = generator.random()
        return float(hidden.smallest * (hidden.largest / hidden.smallest) ** share)
    return spread.size(generator, n=hidden.n_numbers, over=hidden.over, sign=hidden.sign)


def _theta(base: Experiment, scene: Scene, generator: np.random.Generator) -> Array | None:
    """True stiffnesses [kN], then reference strains [%]; None if one exceeds its largest size.

    They are drawn around the subject's own.
    """
    n_lines, conditions = scene.n_lines, scene.conditions
    limit = conditions.largest_shift_pct
    stiffness = (
        0.001
        * base.lines[:n_lines, STIFFNESS]
        * np.exp(generator.normal(0.0, conditions.stiffness_log_sd, n_lines))
    )
    shift = np.clip(generator.normal(0.0, conditions.strain_sd_pct, n_lines), -limit, limit)
    strain = 100.0 * base.lines[:n_lines, REFERENCE_STRAIN] + shift
    most = np.repeat([conditions.most_stiffness_kN, conditions.most_strain_pct], n_lines)
    theta: Array = np.r_[stiffness, strain]
    return theta if np.all(np.abs(theta) <= most) else None


def _noisy(
    exact: Laxity, noise: Noise, generator: np.random.Generator
) -> tuple[Laxity, dict[str, object]]:
    """The data with errors and stated standard deviations, and the true facts about both."""
    is_heavy = bool(generator.random() < HEAVY_SHARE)
    factors = generator.uniform(*STATED_RANGE, 2)
    noisy = add_noise(
        exact,
        sd_mm=noise.sd_mm,
        sd_deg=noise.sd_deg,
        seed=int(generator.integers(2**31)),
        correlation=noise.correlation,
        student_degrees=HEAVY_DEGREES if is_heavy else None,
    )
    true = np.repeat([noise.sd_mm, noise.sd_deg], [3, 2])
    stated = np.tile(true * np.repeat(factors, [3, 2]), (exact.n, 1))
    facts: dict[str, object] = {
        "sd_mm": noise.sd_mm,
        "sd_deg": noise.sd_deg,
        "stated_over_true_mm": float(factors[0]),
        "stated_over_true_deg": float(factors[1]),
        "within_trial_correlation": noise.correlation,
        "student_degrees": HEAVY_DEGREES if is_heavy else None,
    }
    return replace(noisy, sd=stated, within_trial_correlation=0.0), facts


def _truth(knee: Knee, seed: int, found: _Found, facts: Mapping[str, object]) -> Truth:
    names = [f"{x.name}.stiffness_kN" for x in knee.ligaments]
    names += [f"{x.name}.reference_strain_pct" for x in knee.ligaments]
    amplitudes, lines = {}, {}
    for x, size in zip(found.hidden, found.sizes, strict=True):
        amplitudes[x.name] = {"amplitude": (size, x.unit), **dict(x.amplitudes(size))}
        if x.line is not None:
            lines[x.name] = (
                knee.in_scan_frame(knee.femur_frame.to_common(x.line[0])),
                knee.in_scan_frame(knee.tibia_frame.to_common(x.line[1])),
            )
    return Truth(
        seed=seed,
        effects=tuple(x.name for x in found.hidden),
        amplitudes=amplitudes,
        theta=dict(zip(names, found.theta.tolist(), strict=True)),
        signal=found.signal,
        is_largest=found.is_largest,
        lines=lines,
        facts=facts,
    )


LAXITY_FILE = "laxity.csv"


def write_blind(case: BlindCase, folder: PathLike) -> Path:
    """Write a case as ``laxity.csv`` and the sealed ``truth.json``; the path of the folder.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    target = prepare_folder(folder)
    write_laxity(case.laxity, target / LAXITY_FILE)
    write_truth(case.truth, target)
    return target
