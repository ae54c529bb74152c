"""A subject that shares no coordinate, side or name with the reference knee it is made from."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.runs.declare import Array
from identknee.subject.folder import write_subject
from identknee.subject.knee import Frame, Knee, Side
from identknee.subject.ligament import Ligament
from identknee.subject.reference import reference_knee

NAMES = ("cruciate_front", "cruciate_back", "outer", "inner")
FIFTH = Ligament(
    name="oblique",
    femur=np.array([-4.0, 4.0, 39.0]),
    tibia=np.array([9.0, -36.0, 34.0]),
    stiffness_kN=1.5,
    reference_strain_pct=-2.0,
)


def posed_reference(
    seed: int = 0,
    *,
    side: Side = "left",
    edge_mm: float = 2.0,
    scale: float | None = None,
    is_moved: bool = True,
) -> Knee:
    """The reference knee scaled, put anywhere in the scanner, renamed, with a fifth line.

    Its femur is known as a mesh alone. Written to a folder with side left, it is mirrored.
    """
    generator = np.random.default_rng(seed)
    knee = reference_knee(edge_mm)
    if scale is None:
        scale = float(generator.uniform(0.9, 1.1))
    turn, shift = np.eye(3), np.zeros(3)
    if is_moved:
        turn = Rotation.random(random_state=generator).as_matrix()
        shift = generator.uniform(-300.0, 300.0, 3)

    def placed(point: Array) -> Array:
        moved: Array = turn @ (scale * point) + shift
        return moved

    frame = Frame(origin=shift, axes=turn.T)
    return Knee(
        name="posed",
        side=side,
        description='The "reference" knee elsewhere.',
        femur=knee.femur.scaled(scale).moved(turn, shift),
        tibia=tuple(x.scaled(scale).moved(turn, shift) for x in knee.tibia),
        ligaments=tuple(
            replace(x, name=name, femur=placed(x.femur), tibia=placed(x.tibia))
            for x, name in zip((*knee.ligaments, FIFTH), (*NAMES, FIFTH.name), strict=True)
        ),
        femur_frame=frame,
        tibia_frame=frame,
    )


def posed_folder(folder: Path, seed: int = 0, *, side: Side = "left") -> Path:
    """A subject folder that holds such a knee."""
    return write_subject(posed_reference(seed, side=side), folder)
