"""Laxity tables with one convention broken on purpose, and what should name it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identknee.laxity.protocol import LOADS, Protocol, concatenate, load_protocol
from identknee.laxity.table import (
    COORDINATES,
    ROTATIONS,
    TRANSLATIONS,
    Laxity,
    add_noise,
    relative_to_unloaded,
)
from identknee.model.laxity_model import LaxityModel
from identknee.subject.folder import example

NOISE = 0.5  # mm and deg


@dataclass(frozen=True, kw_only=True)
class Planted:
    """How a convention is broken, and how the change that puts it right begins."""

    broken: Callable[[Laxity], Laxity]
    what: str


def clean_table(name: str, seed: int) -> tuple[LaxityModel, Laxity]:
    """A knee, and the laxity of one like it under rotations and drawers, with noise.

    Its stiffnesses differ from the subject's by 20 % and its reference strains by 1 % of strain.
    """
    protocol = concatenate([load_protocol("seed63"), load_protocol("drawer")], name="both")
    model = LaxityModel(knee=example(name), protocol=protocol)
    generator, own = np.random.default_rng(seed), model.parameters
    while True:
        draws = generator.standard_normal(own.n)
        theta = np.where(own.is_log, own.center * np.exp(0.2 * draws), own.center + draws)
        made = model.simulate(theta)
        if made.is_measured.all():
            return model, add_noise(made, sd_mm=NOISE, sd_deg=NOISE, seed=seed)


def _coordinates(laxity: Laxity, columns: slice | list[int], factor: float) -> Laxity:
    values = np.array(laxity.coordinates)
    values[:, columns] *= factor
    return replace(laxity, coordinates=values)


def _loads(laxity: Laxity, columns: slice | list[int], factor: float) -> Laxity:
    loads = np.array(laxity.protocol.loads)
    loads[:, columns] *= factor
    return replace(laxity, protocol=_with_loads(laxity.protocol, loads))


def _with_loads(protocol: Protocol, loads: np.ndarray) -> Protocol:
    return Protocol(
        name=protocol.name,
        trials=protocol.trials,
        flexion_deg=protocol.flexion_deg,
        loads=loads,
    )


def _flipped_surfaces(name: str) -> Planted:
    if name in LOADS:
        k = LOADS.index(name)
        return Planted(broken=lambda x: _loads(x, [k], -1.0), what=f"negating {name}")
    k = COORDINATES.index(name)
    return Planted(broken=lambda x: _coordinates(x, [k], -1.0), what=f"negating {name}")


def _exchanged(one: str, other: str) -> Planted:
    order = list(range(len(COORDINATES)))
    i, j = COORDINATES.index(one), COORDINATES.index(other)
    order[i], order[j] = j, i
    return Planted(
        broken=lambda x: replace(x, coordinates=x.coordinates[:, order]),
        what=f"exchanging {one} and {other}",
    )


PLANTED: Mapping[str, Planted] = {
    "internal rotation flipped": _flipped_surfaces("internal_deg"),
    "varus flipped": _flipped_surfaces("varus_deg"),
    "drawer flipped": _flipped_surfaces("anterior_drawer_mm"),
    "internal moment flipped": _flipped_surfaces("internal_moment_Nm"),
    "varus moment flipped": _flipped_surfaces("varus_moment_Nm"),
    "anterior force flipped": _flipped_surfaces("anterior_force_N"),
    "angles in radians": Planted(
        broken=lambda x: _coordinates(x, ROTATIONS, np.pi / 180.0), what="taking angles for radians"
    ),
    "lengths in m": Planted(
        broken=lambda x: _coordinates(x, TRANSLATIONS, 0.001), what="taking lengths for m "
    ),
    "forces in kN": Planted(
        broken=lambda x: _loads(x, slice(2, 5), 0.001), what="taking forces for kN"
    ),
    "left for right": Planted(
        broken=lambda x: _loads(_coordinates(x, [0, 3, 4], -1.0), [0, 1, 4], -1.0),
        what="taking coordinates and loads for those of the other side",
    ),
    "angles exchanged": _exchanged("varus_deg", "internal_deg"),
    "zeroed unloaded": Planted(
        broken=lambda x: replace(relative_to_unloaded(x), sd=x.sd, zero="absolute"),
        what="counting coordinates from the unloaded pose",
    ),
}
