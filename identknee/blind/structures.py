"""Hidden effects inside the knee: missing structures, wrong tissue, wrong insertions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.blind.energy import line_path
from identknee.blind.experiment import (
    FEMUR_END,
    LIFT,
    LIFT_SHARE,
    LINE_COLUMNS,
    REFERENCE_LENGTH,
    REFERENCE_STRAIN,
    STIFFNESS,
    TIBIA_END,
    TOE,
    Experiment,
    distances,
)
from identknee.blind.hidden import Draw, Hidden, Scene, hidden, line_row, structure_insertions
from identknee.runs.declare import Array

# Slack strain of a structure [%].
STRAIN_PCT, STRAIN_JITTER_PCT = 3.0, 2.0
# Height of the centre of a condyle over its plateau [mm].
CONDYLE_MM = 20.0
N_MM_PER_N_M_DEG = 1000.0 * 180.0 / np.pi


def with_lines(experiment: Experiment, rows: list[Array]) -> Experiment:
    """A copy with lines added."""
    return replace(experiment, lines=np.vstack([experiment.lines, *rows]))


def structure(name: str, *, smallest_kN: float, largest_kN: float) -> Draw:
    """Draw of a missing structure of one line, by its name in `structure_insertions`."""

    def draw(scene: Scene, generator: np.random.Generator) -> Hidden:
        ends = [
            scene.conditions.place(x, generator) for x in structure_insertions(scene.places)[name]
        ]
        return _line_effect(name, scene, ends, _strain(scene, generator), (smallest_kN, largest_kN))

    return draw


def missing_line(scene: Scene, generator: np.random.Generator) -> Hidden:
    """A line anywhere around the knee, from the femur down to the tibia."""
    angle = generator.uniform(0.0, 2.0 * np.pi)
    ends = _around(scene, angle, angle + generator.normal(0.0, 0.35), generator)
    strain = float(generator.uniform(1.0, 7.0))
    return _line_effect("missing_line", scene, ends, strain, (0.1, 1.0))


def broad_strap(scene: Scene, generator: np.random.Generator) -> Hidden:
    """A broad strap: five strands side by side around the knee, tight one after the other."""
    angle = generator.uniform(0.0, 2.0 * np.pi)
    turn, height = generator.normal(0.0, 0.35), generator.uniform(-0.5, 0.5)
    femur, tibia = _around(scene, angle, angle + turn, generator)
    strains = STRAIN_PCT + np.linspace(-4.0, 4.0, 5) * np.sign(height)
    strands = []
    for share in np.linspace(-0.35, 0.35, 5):
        R = _about_y(share)
        strands.append((R @ femur, R @ tibia + np.array([0.0, 8.0 * height * share, 0.0])))
    return _strands_effect("broad_strap", scene, strands, strains, (0.1, 1.5))


def two_point_tether(scene: Scene, generator: np.random.Generator) -> Hidden:
    """A tether from one place on the femur to two on the tibia, 40 deg apart around it."""
    angle = generator.uniform(0.0, 2.0 * np.pi)
    femur, tibia = _around(scene, angle, angle, generator)
    strands = [(femur, _about_y(share) @ tibia) for share in (-0.6, 0.6)]
    return _strands_effect("two_point_tether", scene, strands, np.full(2, STRAIN_PCT), (0.1, 1.0))


def rotational_spring(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """A spring that resists internal rotation either way, and acts along no line."""
    rest = float(generator.normal(0.0, 5.0))

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return replace(experiment, torsion=(amplitude * N_MM_PER_N_M_DEG, float(np.radians(rest))))

    return hidden(
        "rotational_spring",
        ("N·m/deg", 0.02, 0.4),
        apply,
        {"stiffness": 1.0},
        fixed={"rest_angle": (rest, "deg")},
    )


def posterior_capsule(scene: Scene, generator: np.random.Generator) -> Hidden:
    """Medial and lateral posterior capsule, either as a line; the amplitude is the stiffer one."""
    ends = structure_insertions(scene.places)
    strands = [
        [scene.conditions.place(x, generator) for x in ends[f"posterior_capsule_{side}"]]
        for side in ("medial", "lateral")
    ]
    shares, strain = np.r_[1.0, generator.uniform(0.5, 1.0)], _strain(scene, generator)
    generator.shuffle(shares)

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        rows = [
            line_row(scene, x[0], x[1], amplitude * share, strain)
            for x, share in zip(strands, shares.tolist(), strict=True)
        ]
        return with_lines(experiment, rows)

    return hidden(
        "posterior_capsule",
        ("kN", 0.5, 4.0),
        apply,
        {"medial_stiffness_kN": float(shares[0]), "lateral_stiffness_kN": float(shares[1])},
        fixed={"reference_strain_pct": (strain, "%")},
    )


def bundles(scene: Scene, generator: np.random.Generator) -> Hidden:
    """Every ligament but the medial collateral is two bundles that differ in strain and insertion.

    The strains of the two are the ligament's plus and minus the amplitude [%]. Their insertions lie
    0.5 mm for each percent to either side of the ligament's, in random directions.
    """
    split = (scene.places.front, scene.places.rear, scene.places.lateral)
    vectors = generator.normal(size=(*((len(split), 2)), 3))
    aside: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        lines, others = experiment.lines.copy(), []
        for i, (femur, tibia) in zip(split, 0.5 * amplitude * aside, strict=True):
            line = experiment.lines[i]
            halves = [
                line_row(
                    scene,
                    line[FEMUR_END] + sign * femur,
                    line[TIBIA_END] + sign * tibia,
                    0.0005 * line[STIFFNESS],
                    100.0 * line[REFERENCE_STRAIN] + sign * amplitude,
                )
                for sign in (1.0, -1.0)
            ]
            lines[i] = halves[0]
            others.append(halves[1])
        return with_lines(replace(experiment, lines=lines), others)

    return hidden(
        "bundles", ("%", 2.0, 8.0), apply, {"strain_spread": 1.0, "insertion_spread": (0.5, "mm")}
    )


def mcl_wrapping(scene: Scene, generator: np.random.Generator) -> Hidden:
    """The medial collateral is pushed medially near the joint line, and bends there."""
    places = scene.places
    height = places.plateaus[0, 1, 1] + generator.uniform(-8.0, 4.0) * places.scale

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        R, t = scene.start
        lines = experiment.lines.copy()
        line = lines[places.medial]
        top, bottom = R.T @ (line[FEMUR_END] - t), line[TIBIA_END]
        line[LIFT], line[LIFT_SHARE] = -amplitude, (top[1] - height) / (top[1] - bottom[1])
        line[REFERENCE_LENGTH] = line_path(R, t, line)[0]
        return replace(experiment, lines=lines)

    return hidden("mcl_wrapping", ("mm", 2.0, 12.0), apply, {"lift_mm": 1.0})


def meniscus(scene: Scene, generator: np.random.Generator) -> Hidden:
    """Springs hold each condyle along and across its plateau, at rest in the scanned pose."""
    R, t = scene.start
    up = np.array([0.0, CONDYLE_MM * scene.places.scale, 0.0])
    middles = scene.places.plateaus[:, 1] + up
    rest = np.array([scene.conditions.place(x, generator) for x in middles])
    ratio = float(generator.uniform(0.5, 1.0))

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        rows = np.c_[rest @ R.T + t, rest, [amplitude, amplitude * ratio]]
        return replace(experiment, springs=rows)

    return hidden(
        "meniscus", ("N/mm", 5.0, 60.0), apply, {"medial_N_per_mm": 1.0, "lateral_N_per_mm": ratio}
    )


# Number of pads of both menisci and their largest height [mm]. In half-axes of a plateau: the range
# of the ellipse that they leave free, and the half-width of their opening to the other plateau.
N_PADS, HIGHEST_PAD_MM, FREE, OPEN = 300, 7.0, (0.45, 0.65), 0.5


def meniscal_wedge(scene: Scene, generator: np.random.Generator) -> Hidden:
    """Elastic pads around each plateau fill its gap to the femur in the scanned pose.

    They lie at random points outside an ellipse on each plateau, and all are higher or lower than
    the gaps by one offset.
    """
    R, t = scene.start
    low, high = scene.places.plateaus[:, 0], scene.places.plateaus[:, 2]
    middles, halves = 0.5 * (low + high), 0.5 * (high - low)
    free, ratio = generator.uniform(*FREE), float(generator.uniform(0.5, 1.0))
    offset, seed = float(generator.normal(0.0, 0.15)), int(generator.integers(2**32))

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        points = experiment.points
        side = (np.abs(points[:, 2] - middles[1, 2]) < np.abs(points[:, 2] - middles[0, 2])) * 1
        away = (points - middles[side]) / halves[side]
        inward = away[:, 2] * np.where(side == 0, 1.0, -1.0)
        gaps = distances(experiment.wide(), points @ R.T + t)
        may = np.hypot(away[:, 0], away[:, 2]) > free
        may &= (inward < 0.0) | (np.abs(away[:, 0]) > OPEN)
        may &= (gaps > 0.0) & (gaps < HIGHEST_PAD_MM)
        found = np.flatnonzero(may)
        drawn = np.random.default_rng(seed).permutation(found)[:N_PADS]
        areas = experiment.areas[drawn] * experiment.areas[found].sum()
        areas /= experiment.areas[drawn].sum()
        stiffness = amplitude * areas * np.where(side[drawn] == 0, 1.0, ratio)
        pads = np.c_[points[drawn], stiffness, gaps[drawn] + offset]
        return replace(experiment, pads=pads)

    return hidden(
        "meniscal_wedge",
        ("N/mm3", 0.2, 4.0),
        apply,
        {"medial_stiffness_N_per_mm3": 1.0, "lateral_stiffness_N_per_mm3": ratio},
        fixed={"offset_mm": (offset, "mm")},
    )


def toe_strain(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """The toe of every ligament ends at another strain."""
    return hidden(
        "toe_strain",
        ("%", 0.5, 1.8),
        lambda experiment, a: replace(
            experiment, lines=experiment.lines + 0.01 * a * (np.arange(LINE_COLUMNS) == TOE)
        ),
        {"transition_strain_pct": 1.0},
        sign=float(generator.choice([-1.0, 1.0])),
    )


def cartilage(_scene: Scene, generator: np.random.Generator) -> Hidden:
    """Contact is stiffer or softer throughout; the amplitude is the logarithm of the factor."""
    return hidden(
        "cartilage",
        ("1", 0.4, 2.3),
        lambda experiment, a: replace(experiment, modulus=experiment.modulus * float(np.exp(a))),
        {"ln_modulus": 1.0},
        sign=float(generator.choice([-1.0, 1.0])),
    )


def insertion(scene: Scene, generator: np.random.Generator) -> Hidden:
    """Every insertion is shifted; the amplitude is the root mean square of the coordinates."""
    n = scene.n_lines
    shifts = generator.normal(size=(n, 6))
    shifts /= np.sqrt((shifts**2).mean())

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        R, t = scene.start
        lines = experiment.lines.copy()
        lines[:n, :6] += amplitude * shifts
        way = lines[:n, TIBIA_END] @ R.T + t - lines[:n, FEMUR_END]
        lines[:n, REFERENCE_LENGTH] = np.linalg.norm(way, axis=1)
        return replace(experiment, lines=lines)

    return hidden(
        "insertion",
        ("mm", 1.0, 4.0),
        apply,
        {"rms_shift": 1.0},
        n_numbers=6 * n,
        over=float(np.sqrt(6 * n)),
    )


def _line_effect(
    name: str, scene: Scene, ends: Sequence[Array], strain_pct: float, sizes_kN: tuple[float, float]
) -> Hidden:
    """Effect of one added line; its amplitude is the stiffness."""
    femur, tibia = ends

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        return with_lines(experiment, [line_row(scene, femur, tibia, amplitude, strain_pct)])

    return hidden(
        name,
        ("kN", *sizes_kN),
        apply,
        {"stiffness_kN": 1.0},
        fixed={"reference_strain_pct": (strain_pct, "%")},
        line=(femur, tibia),
    )


def _strands_effect(
    name: str,
    scene: Scene,
    strands: Sequence[tuple[Array, Array]],
    strains_pct: Array,
    sizes_kN: tuple[float, float],
) -> Hidden:
    """Effect of several lines that share a stiffness and have no common line of action."""

    def apply(experiment: Experiment, amplitude: float) -> Experiment:
        rows = [
            line_row(scene, *ends, amplitude / len(strands), float(strain))
            for ends, strain in zip(strands, strains_pct, strict=True)
        ]
        return with_lines(experiment, rows)

    return hidden(name, ("kN", *sizes_kN), apply, {"stiffness_kN": 1.0})


def _around(
    scene: Scene, femoral_angle: float, tibial_angle: float, generator: np.random.Generator
) -> tuple[Array, Array]:
    """A point on each bone [mm] at an angle [rad] about the long axis, zero in front."""
    places = scene.places
    low, high = places.plateaus[:, 0].min(axis=0), places.plateaus[:, 2].max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + 2.0
    femoral_half = np.array([26.0 * places.scale, 0.5 * np.ptp(places.epicondyles[:, 2])])
    femur = np.array(
        [
            femoral_half[0] * np.cos(femoral_angle),
            places.scale * generator.uniform(-5.0, 15.0),
            femoral_half[1] * np.sin(femoral_angle) + places.epicondyles[:, 2].mean(),
        ]
    )
    tibia = np.array(
        [
            middle[0] + half[0] * np.cos(tibial_angle),
            middle[1] - places.scale * generator.uniform(3.0, 30.0),
            middle[2] + half[2] * np.sin(tibial_angle),
        ]
    )
    return femur, tibia


def _about_y(angle: float) -> Array:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])


def _strain(scene: Scene, generator: np.random.Generator) -> float:
    if scene.conditions.structure_strain_pct is not None:
        return scene.conditions.structure_strain_pct.value(generator)
    return float(STRAIN_PCT + generator.uniform(-STRAIN_JITTER_PCT, STRAIN_JITTER_PCT))
