"""A knee of two spheres on two shallow dishes: small, so that its distance field is built at once.

Its femur's distance has a closed form, nothing about it is symmetric, and it bears loads of a few
hundred newtons near extension.
"""

from dataclasses import dataclass

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.knee import Frame, Knee
from identknee.subject.ligament import Ligament
from identknee.subject.surface import Surface, joined

CENTRES = np.array([[0.0, 0.5, -9.0], [0.8, 1.0, 9.5]])
RADII = np.array([8.0, 8.5])
BOTTOM = CENTRES[:, 1] - RADII
DISH_CURVATURE = 1 / 25.0
HALF, EDGE = 7.8, 0.65


@dataclass(frozen=True, kw_only=True)
class TwoSpheres:
    """Signed distance to both spheres, seen from a frame that moved with them."""

    rotation: Array
    translation: Array

    def __call__(self, points: Array) -> Array:
        local = (points - self.translation) @ self.rotation
        apart = [np.linalg.norm(local - c, axis=1) - r for c, r in zip(CENTRES, RADII, strict=True)]
        return np.asarray(np.minimum(*apart))


def small_knee(
    *,
    rotation: Array | None = None,
    translation: Array | None = None,
    names: tuple[str, ...] = ("front", "back", "outer", "inner"),
) -> Knee:
    """The knee, all of it moved to ``rotation @ x + translation`` in the scanner."""
    turn = np.eye(3) if rotation is None else rotation
    shift = np.zeros(3) if translation is None else translation
    frame = Frame(origin=shift, axes=turn.T)
    return Knee(
        name="small",
        side="right",
        femur=joined(*(_ball(c, r) for c, r in zip(CENTRES, RADII, strict=True))).moved(
            turn, shift
        ),
        tibia=tuple(_dish(i).moved(turn, shift) for i in range(2)),
        ligaments=tuple(
            Ligament(
                name=name,
                femur=turn @ np.array(femur) + shift,
                tibia=turn @ np.array(tibia) + shift,
                stiffness_kN=stiffness,
                reference_strain_pct=strain,
            )
            for name, (femur, tibia, stiffness, strain) in zip(names, _LINES, strict=True)
        ),
        femur_frame=frame,
        tibia_frame=frame,
        femur_distance=TwoSpheres(rotation=turn, translation=shift),
    )


# Crossed lines in the middle, upright ones at the sides: femur, tibia, kN, %.
_LINES = (
    ([-4.0, 4.0, 2.0], [6.0, -9.0, 0.0], 2.0, 5.0),
    ([4.0, 3.0, -2.0], [-7.0, -10.0, 0.5], 3.0, 5.0),
    ([0.0, 3.0, 20.0], [-1.5, -16.0, 18.5], 1.5, 6.0),
    ([0.0, 4.0, -19.0], [1.0, -20.0, -18.0], 2.0, 6.5),
)


def small_protocol() -> Protocol:
    """Loads of every kind, one and two at a time, at two angles."""
    rows = [
        ("unloaded", 0.0, [0, 0, 0, 0, 0]),
        ("internal", 0.0, [0.4, 0, 0, 0, 0]),
        ("valgus", 8.0, [0, -0.8, 0, 0, 0]),
        ("anterior", 8.0, [0, 0, 30, 0, 0]),
        ("compressed", 0.0, [0, 0.4, 0, -40, 0]),
        ("medial", 8.0, [-0.3, 0, -10, 0, -20]),
    ]
    return Protocol(
        name="small",
        trials=tuple(name for name, _, _ in rows),
        flexion_deg=np.array([flexion for _, flexion, _ in rows]),
        loads=np.array([loads for _, _, loads in rows], float),
    )


def _ball(centre: Array, radius: float) -> Surface:
    """A sphere of triangles, without poles where it touches."""
    n, m = 24, 36
    polar = np.pi * (np.arange(n) + 0.5) / n
    around = 2.0 * np.pi * np.arange(m) / m
    p, a = np.meshgrid(polar, around, indexing="ij")
    unit = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing="ij")
    here, right = (i * m + j).ravel(), (i * m + (j + 1) % m).ravel()
    faces = np.r_[
        np.stack([here, here + m, right + m], axis=1), np.stack([here, right + m, right], axis=1)
    ]
    return Surface(vertices=(centre + radius * unit).reshape(-1, 3), faces=faces)


def _dish(i: int) -> Surface:
    ticks = np.arange(-HALF, HALF + EDGE / 2, EDGE)
    n = len(ticks)
    x, z = np.meshgrid(ticks, ticks, indexing="ij")
    y = BOTTOM[i] + 0.5 * DISH_CURVATURE * (x**2 + z**2)
    vertices = np.stack([x + CENTRES[i, 0], y, z + CENTRES[i, 2]], axis=-1).reshape(-1, 3)
    a, b = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    c = (a * n + b).ravel()
    faces = np.r_[np.stack([c, c + 1, c + n + 1], 1), np.stack([c, c + n + 1, c + n], 1)]
    return Surface(vertices=vertices, faces=faces)


def as_read() -> Laxity:
    """What the knee does under loads and their opposites, at angles as a rig reads them."""
    nominal = small_protocol()
    loads = nominal.loads[~nominal.is_unloaded]
    n = 2 * len(loads)
    protocol = Protocol(
        name="as read",
        trials=tuple(f"trial {i}" for i in range(n)),
        flexion_deg=np.linspace(3.1, 15.7, n),
        loads=np.concatenate([loads, -loads]),
    )
    model = LaxityModel(knee=small_knee(), protocol=protocol)
    return model.simulate(model.parameters.start)
