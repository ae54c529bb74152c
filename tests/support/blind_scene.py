"""A stage for hidden effects on which all they do can be written down: four lines, five trials."""

import numpy as np

from identknee.blind.conditions import STANDARD, Conditions
from identknee.blind.effects import EFFECTS
from identknee.blind.experiment import LINE_COLUMNS, DistanceGrid, Experiment
from identknee.blind.hidden import AnatomicalSites, Hidden, Scene
from identknee.laxity.protocol import Protocol

# Internal, varus [N·m]; anterior, distraction, lateral [N].
LOADS = np.array(
    [
        [8.0, 0.0, 0.0, 0.0, 0.0],
        [-6.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 5.0, 0.0, 0.0, 0.0],
        [0.0, -4.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 30.0, 20.0, 10.0],
    ]
)
FLEXION_DEG = np.array([0.0, 30.0, 60.0, 90.0, 30.0])
ORDER = np.array([3, 1, 2, 5, 4])
IS_UNLOADING = np.array([False, True, True, False, False])
# Of a tibia 40 mm below the femur, not turned.
START = (np.eye(3), np.array([0.0, -40.0, 0.0]))
STIFFNESS_N, STRAIN, TOE = 2000.0, 0.04, 0.03


def protocol() -> Protocol:
    return Protocol(name="five", trials=tuple("abcde"), flexion_deg=FLEXION_DEG, loads=LOADS)


def scene(conditions: Conditions = STANDARD) -> Scene:
    plateaus = np.array(
        [
            [[-20.0, -42.0, -40.0], [0.0, -40.0, -22.0], [20.0, -38.0, -5.0]],
            [[-18.0, -41.0, 5.0], [1.0, -39.0, 21.0], [18.0, -37.0, 38.0]],
        ]
    )
    plateaus[:, :, 1] += 40.0
    places = AnatomicalSites(
        scale=1.0,
        medial=0,
        lateral=1,
        front=2,
        rear=3,
        epicondyles=np.array([[0.0, 0.0, -41.0], [0.0, 0.0, 42.0]]),
        plateaus=plateaus,
        fibula=np.array([-15.0, -20.0, 40.0]),
        femur=np.array([[-35.0, -25.0, -40.0], [35.0, 20.0, 40.0]]),
    )
    return Scene(
        places=places,
        n_lines=4,
        start=START,
        load_Nm=LOADS[:, :2],
        order=ORDER,
        is_unloading=IS_UNLOADING,
        conditions=conditions,
    )


def experiment() -> Experiment:
    """Without effects and without contact: the femur's surface is out of reach."""
    lines = np.zeros((4, LINE_COLUMNS))
    lines[:, :3] = [[0.0, 0.0, -41.0], [0.0, 0.0, 42.0], [-2.0, 0.0, 8.0], [2.0, -5.0, -8.0]]
    lines[:, 3:6] = [[5.0, -30.0, -30.0], [-15.0, -20.0, 40.0], [10.0, 2.0, 2.0], [-20.0, 0.0, 0.0]]
    lines[:, 6] = np.linalg.norm(lines[:, 3:6] + START[1] - lines[:, :3], axis=1)
    lines[:, 7:10] = STIFFNESS_N, STRAIN, TOE
    loads = LOADS[:, [1, 0, 2, 3, 4]] * [1000.0, 1000.0, 1.0, 1.0, 1.0]
    grid = DistanceGrid(values=np.full((8, 8, 8), 5.0), origin=np.zeros(3), spacing=1.0)
    return Experiment(
        points=np.zeros((1, 3)),
        areas=np.ones(1),
        grid=grid,
        start=START,
        lines=lines,
        protocol=protocol(),
        loads=loads,
        preload=np.zeros(5),
        flexion_offset=0.0,
        modulus=8.6,
        exponent=1.25,
        weights=np.zeros((0, 6)),
        springs=np.zeros((0, 7)),
        torsion=(0.0, 0.0),
        pads=np.zeros((0, 5)),
        wide=lambda: grid,
        femur_turn=np.zeros(3),
        tibia_turn=np.zeros(3),
        added=np.zeros((5, 5)),
    )


def drawn(name: str, seed: int = 3, conditions: Conditions = STANDARD) -> Hidden:
    """An effect as one seed draws it."""
    return EFFECTS[name](scene(conditions), np.random.default_rng(seed))


def numbers(hidden: Hidden, amplitude: float) -> dict[str, float]:
    """Every number that the truth tells of an effect, by its name."""
    return {name: value for name, (value, _) in hidden.amplitudes(amplitude).items()}
