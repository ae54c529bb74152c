"""Hidden effects of the rig: loads, frames, readings, and what depends on the order of trials."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from identknee.blind.experiment import N_MM_PER_N_M, Experiment
from identknee.blind.hidden import Apply, Draw, Hidden, Scene, hidden
from identknee.laxity.table import COORDINATES
from identknee.runs.declare import Array

# The shank's centre of mass below the tibial origin [mm].
SHANK_MM = 180.0
VARUS_MOMENT, INTERNAL_MOMENT, ANTERIOR, DISTRACTION, LATERAL = range(5)
VARUS_READING, INTERNAL_READING = 3, 4
# Amplitude of an effect in varus over that in internal rotation, whose range is larger.
VARUS_SHARE = 0.4
WIDTHS = {"IE_deg": 1.0, "VV_deg": VARUS_SHARE}
FULL_MOMENT_NM = 10.0


def compression(_scene: Scene, _generator: np.random.Generator) -> Hidden:
    """A constant joint compression in all trials."""

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        change = np.zeros(5)
        change[DISTRACTION] = -amplitude
        return _loaded(experiment, change)

    return hidden("compression", ("N", 20.0, 200.0), apply, {"force_N": 1.0})


def shank_gravity(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """The weight of the shank acts on the knee, posteriorly or distally."""
    angle = float(generator.uniform(0.0, 0.5 * np.pi))
    way = np.array([-np.cos(angle), -np.sin(angle), 0.0])

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        row = np.r_[amplitude * way, 0.0, -SHANK_MM, 0.0]
        return replace(experiment, weights=np.vstack([experiment.weights, row]))

    return hidden(
        "shank_gravity",
        ("N", 8.0, 40.0),
        apply,
        {"posterior_N": float(np.cos(angle)), "distal_N": float(np.sin(angle))},
        n_numbers=2,
    )


def muscle_tension(scene: Scene, generator: np.random.Generator) -> Hidden:
    """Three muscles pull with constant forces; the amplitude is the norm of the three forces.

    The hamstrings draw the back of the tibia towards the hip, in a direction fixed to the femur.
    The patellar tendon leans forward, less so with flexion. The gastrocnemius acts along the tibia,
    from the femoral condyles.
    """
    way = np.abs(_unit(generator, 3))
    lean, back, heel = generator.normal([20.0, 0.0, 3.0], [3.0, 3.0, 1.5])
    slope = float(generator.normal(0.3, 0.04))
    side = generator.normal([5.0, -7.0], 4.0) * scene.places.scale
    (low, middle, _), _ = scene.places.plateaus
    inner = np.array([low[0], middle[1] - 10.0, middle[2]])
    towards_hip = np.array([-np.sin(np.radians(back)), np.cos(np.radians(back)), 0.0])

    def pulled(angles_deg: Array, force: float, lateral: float) -> Array:
        """Loads of a pull that leans forward by these angles, shape ``(n, 5)``."""
        ahead, up = force * np.sin(np.radians(angles_deg)), force * np.cos(np.radians(angles_deg))
        return np.asarray(np.c_[-lateral * up, lateral * ahead, ahead, -up, 0.0 * up])

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        quadriceps, hamstrings, gastrocnemius = amplitude * way
        flexion = np.asarray(experiment.protocol.flexion_deg)
        change = pulled(lean - slope * flexion, quadriceps, side[0])
        change = change + pulled(np.full(len(flexion), heel), gastrocnemius, side[1])
        rows = [
            np.r_[share * hamstrings * towards_hip, place]
            for share, place in ((2.0 / 3.0, inner), (1.0 / 3.0, scene.places.fibula))
        ]
        return replace(
            experiment,
            loads=experiment.loads + change,
            preload=experiment.preload + change.mean(axis=0),
            weights=np.vstack([experiment.weights, *rows]),
        )

    names = ("quadriceps_N", "hamstrings_N", "gastrocnemius_N")
    shares = dict(zip(names, way.tolist(), strict=True))
    return hidden("muscle_tension", ("N", 20.0, 200.0), apply, shares, n_numbers=3)


def constant_pull(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """A cable pulls the shank to one side, off its axis, as neither weight nor muscle does."""
    across = float(generator.choice([-1.0, 1.0]) * generator.uniform(0.6, 0.95))
    angle = float(generator.uniform(0.0, 2.0 * np.pi))
    rest = np.sqrt(1.0 - across**2)
    way = np.array([rest * np.cos(angle), rest * np.sin(angle), across])
    place = np.r_[generator.uniform(-30.0, 30.0), generator.uniform(-60.0, -10.0), 0.0]
    place[2] = generator.uniform(-50.0, 50.0)

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        row = np.r_[amplitude * way, place]
        return replace(experiment, weights=np.vstack([experiment.weights, row]))

    return hidden("constant_pull", ("N", 5.0, 60.0), apply, {"force_N": 1.0})


def one_way_yield(scene: Scene, generator: np.random.Generator) -> Hidden:
    """The rig gives way under one direction of the internal moment only."""
    way = _sign(generator)
    shape = way * np.maximum(way * scene.load_Nm[:, 0], 0.0)
    size = ("deg/N·m", 0.05, 1.0)
    return _reading_effect("one_way_yield", size, _at(INTERNAL_READING, shape), {"yield": 1.0})


def moment_gain(axis: str) -> Draw:
    """Draw of a scale error of a moment, ``"IE"`` or ``"VV"``."""
    which = INTERNAL_MOMENT if axis == "IE" else VARUS_MOMENT

    def draw(_scene: Scene, generator: np.random.Generator) -> Hidden:
        def apply(experiment: Experiment, amplitude: float) -> Experiment:
            loads = experiment.loads.copy()
            loads[:, which] += amplitude * _stated(experiment)[:, which]
            return replace(experiment, loads=loads)

        return hidden(
            f"moment_gain_{axis}", ("1", 0.05, 0.4), apply, {"gain": 1.0}, sign=_sign(generator)
        )

    return draw


def moment_offset(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """A constant zero error of the moments about both axes."""
    angle = float(generator.uniform(0.0, 2.0 * np.pi))
    share = np.array([np.sin(angle), np.cos(angle)])

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return _loaded(experiment, np.r_[amplitude * N_MM_PER_N_M * share, 0.0, 0.0, 0.0])

    return hidden(
        "moment_offset",
        ("N·m", 0.2, 1.5),
        apply,
        {"IE_Nm": float(share[1]), "VV_Nm": float(share[0])},
        n_numbers=2,
    )


def axis_misalignment(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """Each moment also acts about the other axis; the amplitude is the norm of both angles."""
    way = _unit(generator, 2)

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        stated, loads = _stated(experiment), experiment.loads.copy()
        sine = np.sin(np.radians(amplitude * way))
        loads[:, INTERNAL_MOMENT] += sine[0] * stated[:, VARUS_MOMENT]
        loads[:, VARUS_MOMENT] += sine[1] * stated[:, INTERNAL_MOMENT]
        return replace(experiment, loads=loads)

    return hidden(
        "axis_misalignment",
        ("deg", 2.0, 10.0),
        apply,
        {"VV_to_IE_deg": float(way[0]), "IE_to_VV_deg": float(way[1])},
        n_numbers=2,
    )


def parasitic_shear(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """Each moment comes with a force across the tibia, forward or to the side."""
    way = generator.normal(size=(2, 2))
    way /= np.linalg.norm(way)

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        loads = experiment.loads.copy()
        forces = amplitude * (_stated(experiment)[:, :2] / N_MM_PER_N_M) @ way
        loads[:, [ANTERIOR, LATERAL]] += forces
        return replace(experiment, loads=loads)

    names = [f"{axis}_{towards}_N_per_Nm" for axis in ("VV", "IE") for towards in ("x", "z")]
    return hidden(
        "parasitic_shear",
        ("N/N·m", 0.3, 3.0),
        apply,
        {x: float(w) for x, w in zip(names, way.ravel(), strict=True)},
        n_numbers=4,
    )


def femur_frame(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """The rig's femoral frame is turned about the anterior and the superior axis."""
    way = np.r_[_unit(generator, 2), 0.0]

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return replace(experiment, femur_turn=np.radians(amplitude) * way)

    return _turn_effect("femur_frame", way, apply)


def tibia_frame(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """The rig's tibial frame is turned about a random axis."""
    way = _unit(generator, 3)

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return replace(experiment, tibia_turn=np.radians(amplitude) * way)

    return _turn_effect("tibia_frame", way, apply)


def flexion_offset(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """An error of the flexion angle."""

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return replace(experiment, flexion_offset=float(np.radians(amplitude)))

    return hidden(
        "flexion_offset", ("deg", 1.0, 6.0), apply, {"flexion_deg": 1.0}, sign=_sign(generator)
    )


def rig_compliance(axis: str) -> Draw:
    """Draw of a rig that yields and so adds its own rotation, about ``"IE"`` or ``"VV"``."""
    column, reading = (0, INTERNAL_READING) if axis == "IE" else (1, VARUS_READING)

    def draw(scene: Scene, _generator: np.random.Generator) -> Hidden:
        return _reading_effect(
            f"rig_compliance_{axis}",
            ("deg/N·m", 0.05, 0.6),
            _at(reading, scene.load_Nm[:, column]),
            {"compliance_deg_per_Nm": 1.0},
        )

    return draw


def hysteresis(scene: Scene, _generator: np.random.Generator) -> Hidden:
    """Readings lag behind the load: smaller rotations during loading, larger during unloading.

    The amplitude is the width of the loop of internal rotation; that of varus is 0.4 times as wide.
    """
    lag = np.sign(scene.load_Nm) * np.where(scene.is_unloading, 0.5, -0.5)[:, None]
    shape = _at(INTERNAL_READING, lag[:, 0]) + VARUS_SHARE * _at(VARUS_READING, lag[:, 1])
    return _reading_effect("hysteresis", ("deg", 0.3, 6.0), shape, WIDTHS)


def creep(scene: Scene, _generator: np.random.Generator) -> Hidden:
    """The rotation under load grows with the logarithm of the number of trials made.

    The amplitude is the growth of internal rotation at 10 N·m for each e-fold of trials; that of
    varus is 0.4 times as large.
    """
    grown = np.log(scene.order)[:, None] * scene.load_Nm / FULL_MOMENT_NM
    shape = _at(INTERNAL_READING, grown[:, 0]) + VARUS_SHARE * _at(VARUS_READING, grown[:, 1])
    return _reading_effect("creep", ("deg", 0.1, 2.0), shape, WIDTHS)


def drift(scene: Scene, generator: np.random.Generator) -> Hidden:
    """All readings drift in proportion to the number of trials made."""
    way = _unit(generator, 5)
    share = (scene.order - 1.0) / max(len(scene.order) - 1, 1) - 0.5
    parts = dict(zip(COORDINATES, way.tolist(), strict=True))
    return replace(
        _reading_effect("drift", ("mm or deg", 0.2, 4.0), share[:, None] * way, parts), n_numbers=5
    )


def _loaded(experiment: Experiment, change: Array) -> Experiment:
    """A copy with a load added to every trial and to the unloaded state."""
    return replace(experiment, loads=experiment.loads + change, preload=experiment.preload + change)


def _stated(experiment: Experiment) -> Array:
    """Loads as stated: varus and internal moment [N mm], forces [N], shape ``(n, 5)``."""
    loads = experiment.protocol.loads[:, [1, 0, 2, 3, 4]].copy()
    loads[:, :2] *= N_MM_PER_N_M
    return loads


def _reading_effect(
    name: str, size: tuple[str, float, float], shape: Array, parts: Mapping[str, float]
) -> Hidden:
    """Effect that adds its amplitude times `shape` (n, 5) to what is read, part by part."""

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return replace(experiment, added=experiment.added + amplitude * shape)

    return hidden(name, size, apply, parts)


def _turn_effect(name: str, way: Array, apply: Apply) -> Hidden:
    return hidden(
        name,
        ("deg", 1.0, 6.0),
        apply,
        {f"{x}_deg": float(w) for x, w in zip("xyz", way, strict=True)},
        n_numbers=int(np.count_nonzero(way)),
    )


def _at(reading: int, values: Array) -> Array:
    """Values ``(n,)`` in the column of one reading, shape ``(n, 5)``."""
    columns = np.zeros((len(values), 5))
    columns[:, reading] = values
    return columns


def _unit(generator: np.random.Generator, n: int) -> Array:
    vector = generator.normal(size=n)
    return np.asarray(vector / np.linalg.norm(vector))


def _sign(generator: np.random.Generator) -> float:
    return float(generator.choice([-1.0, 1.0]))
