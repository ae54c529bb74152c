"""Inputs of any size: laxity tables of many trials, and knees of many triangles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.subject.folder import example, write_subject
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface

NOISE = 0.3  # mm and deg
# Of random flexion [deg] and loads [N m, N m, N, N, N], the largest.
MOST_FLEXION = 90.0
MOST_LOADS = np.array([5.0, 10.0, 100.0, 20.0, 20.0])
# Height [mm] and wavelength [mm] of the waves that keep subdivided triangles from being coplanar.
HEIGHT, WAVELENGTH = 0.02, 7.0


def many_trials(n: int, *, seed: int = 0) -> Protocol:
    """Trials at random angles of flexion under random loads."""
    generator = np.random.default_rng(seed)
    return Protocol(
        name=f"{n} random trials",
        trials=tuple(f"trial{i}" for i in range(n)),
        flexion_deg=generator.uniform(0.0, MOST_FLEXION, n),
        loads=generator.uniform(-MOST_LOADS, MOST_LOADS, (n, 5)),
    )


def large_table(n: int, *, seed: int = 0) -> Laxity:
    """Laxity of the reference knee in that many random trials, with noise that it states."""
    model = LaxityModel(knee=example("reference"), protocol=many_trials(n, seed=seed))
    own = model.simulate(model.parameters.center)
    return add_noise(own, sd_mm=NOISE, sd_deg=NOISE, seed=seed)


def subdivided(surface: Surface, times: int) -> Surface:
    """The surface with four triangles in the place of each, so many times over, slightly wavy."""
    remesh: Any = trimesh.remesh
    vertices, faces = surface.vertices, surface.faces
    for _ in range(times):
        vertices, faces = remesh.subdivide(vertices, faces)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    waves = np.sin(2.0 * np.pi / WAVELENGTH * vertices).prod(axis=1)
    return Surface(vertices=vertices + HEIGHT * waves[:, None] * mesh.vertex_normals, faces=faces)


def fine_knee(name: str, times: int) -> Knee:
    """A shipped knee whose surfaces are subdivided, as fine as segmentation gives them."""
    knee = example(name)
    medial, lateral = knee.tibia
    return replace(
        knee,
        name=f"{name}_fine",
        femur=subdivided(knee.femur, times),
        tibia=(subdivided(medial, times), subdivided(lateral, times)),
        femur_distance=None,
    )


def write_fine_knee(name: str, times: int, folder: Path) -> int:
    """How many triangles a subdivided knee has, written as a subject folder."""
    knee = fine_knee(name, times)
    write_subject(knee, folder)
    return sum(len(x.faces) for x in (knee.femur, *knee.tibia))
