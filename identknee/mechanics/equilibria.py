"""Equilibria of a set of trials: the kernel's door for the rest of the package."""

import threading
from functools import cache, lru_cache
from typing import Any

import numpy as np

from identknee.mechanics.branch_threads import run_shared
from identknee.mechanics.contact_law import ContactLaw
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.load_paths import LoadPaths, loaded_at_once
from identknee.mechanics.machine_code import MachineCode, Packed
from identknee.mechanics.memory import (
    NO_EQUILIBRIUM,
    ROTATION_SCALE,
    ContactArrays,
    Equilibria,
    LigamentArrays,
    NodeArrays,
)
from identknee.mechanics.workspace import KeptWorkspace
from identknee.runs.arrays import Array, IntArray, frozen
from identknee.runs.declare import array, declared, entry

TRANSITION_STRAIN = 0.03
simulate_path = MachineCode("identknee.mechanics.kernel", "simulate_path")


@declared
class ContactPoints:
    """Points of the tibial surface that carry contact, in tibial axes."""

    points: Array = array("Places", "point", "axis", unit="mm")
    areas: Array = array("Tributary areas", "point", unit="mm2")
    compartment: IntArray = array("Which tibial surface each belongs to", "point", dtype=int)
    law: ContactLaw | None = entry(
        "The contact law, with sensitivities to it; the paper's, without them, where None",
        default=None,
    )

    @property
    def n_compartments(self) -> int:
        """How many tibial surfaces there are."""
        return int(self.compartment.max()) + 1

    def arrays(self) -> ContactArrays:
        """The points as the kernel takes them."""
        law = self.law or ContactLaw()
        radius = np.array([np.linalg.norm(self.points, axis=1).max()])
        return ContactArrays(
            points=np.ascontiguousarray(self.points.T),
            radius=radius,
            stiffness=law.modulus * self.areas,
            compartment=self.compartment,
            exponent=np.array([law.exponent]),
            rounding=np.array([law.rounding]),
        )


@declared
class Lines:
    """Line ligaments: insertions in femoral and tibial axes, and what does not change in a fit."""

    femoral: Array = entry("Femoral insertions [mm], shape ``(m, 3)``")
    tibial: Array = entry("Tibial insertions, likewise")
    reference_length: Array = entry("Length in the scanned pose [mm], shape ``(m,)``")
    transition: Array | float = entry(
        "Strain at which the force-strain curve has half its final slope, shape ``(m,)``; negative "
        "for a spring, linear in tension and compression",
        default=TRANSITION_STRAIN,
    )
    wrap_offset: Array | float = entry(
        "How far something pushes each line aside, towards femoral z [mm], shape ``(m,)``",
        default=0.0,
    )
    wrap_place: Array | float = entry(
        "Where it does, as a share of the way from the tibia to the femur, shape ``(m,)``",
        default=0.5,
    )

    def __post_init__(self) -> None:
        m = len(self.femoral)
        for name in ("femoral", "tibial"):
            object.__setattr__(self, name, frozen(getattr(self, name), m, 3, name=name))
        for name in ("reference_length", "transition", "wrap_offset", "wrap_place"):
            values = getattr(self, name)
            values = np.full(m, values) if np.ndim(values) == 0 else values
            object.__setattr__(self, name, frozen(values, m, name=name))

    def arrays(self, stiffness: Array, reference_strain: Array) -> LigamentArrays:
        """The ligaments with stiffness [N] and reference strain, as the kernel takes them."""
        course = (self.reference_length, self.transition, self.wrap_offset, self.wrap_place)
        properties = np.empty((len(self.femoral), 6))
        for i, column in enumerate((stiffness, reference_strain, *course)):
            properties[:, i] = column
        return LigamentArrays(femoral=self.femoral, tibial=self.tibial, properties=properties)


def solve(
    paths: LoadPaths,
    start: Array,
    contact: ContactPoints,
    field: DistanceField,
    ligaments: LigamentArrays,
    *,
    derivatives: bool = True,
    guesses: Array | None = None,
) -> Equilibria:
    """The equilibria at the nodes of `paths`, beginning the search at the pose `start`.

    Parameters
    ----------
    start
        Varus, internal [rad], x, y, z [mm], shape ``(5,)``, or one for each node, ``(n_nodes, 5)``.
        Those of nodes reached from others are not looked at.
    guesses
        Poses to try first, shape ``(n_nodes, 5)``. A guess is kept only if the equilibrium found
        from it agrees with its neighbour's tangents, as one found without must.
    """
    n, m = len(paths.flexion), len(ligaments.femoral)
    found = Equilibria(
        poses=np.zeros((n, 5)),
        hessians=np.zeros((n, 5, 5)),
        sensitivities=np.zeros((n, 5, 2 * m + 2 * (contact.law is not None))),
        gradient_by_flexion=np.zeros((n, 5)),
        codes=np.full(n, NO_EQUILIBRIUM),
        residuals=np.zeros(n),
        reached=np.zeros(n),
        contact_sums=np.zeros((n, 39)),
        centres=np.zeros((n, contact.n_compartments, 7)),
        solves=np.zeros(n, np.int64),
    )
    starts = np.empty((n, 5))
    starts[:] = start
    before, n_columns = _packed_nodes(paths), found.sensitivities.shape[2]
    # Packed once for all threads.
    between = (
        Packed(starts),
        Packed(np.zeros((n, 5)) if guesses is None else np.array(guesses)),
        guesses is not None,
        _packed_contact(contact),
        _packed_field(field),
        Packed(ligaments),
        derivatives,
    )
    after = Packed(found)

    def arguments_of(share: Packed, kept: KeptWorkspace) -> tuple[Any, ...]:
        return before, share, *between, kept.fitting(len(contact.points), n_columns), after

    run_shared(simulate_path, paths.parent, arguments_of)
    return found


@cache
def begin_compiling() -> None:
    """Have the compiled code made or loaded while the caller does something that takes longer."""
    threading.Thread(target=_solve_the_smallest, daemon=True).start()


def _solve_the_smallest() -> None:
    """Solve one trial of a joint that has one contact point and no ligament."""
    contact = ContactPoints(
        points=np.zeros((1, 3)), areas=np.ones(1), compartment=np.zeros(1, np.int64)
    )
    nowhere = np.zeros((4, 4, 4))
    field = DistanceField(
        coefficients=nowhere,
        reach=nowhere.astype(np.uint16),
        near=nowhere.astype(np.uint8),
        origin=np.zeros(3),
        spacing=1.0,
    )
    none = np.zeros((0, 3))
    lines = Lines(femoral=none, tibial=none, reference_length=np.zeros(0))
    ligaments = lines.arrays(np.zeros(0), np.zeros(0))
    solve(loaded_at_once(np.zeros(1), np.zeros((1, 5))), np.zeros(5), contact, field, ligaments)


@lru_cache(maxsize=4)
def _packed_nodes(paths: LoadPaths) -> Packed:
    """The tree of load paths as the kernel takes it, packed once for many simulations."""
    farthest = np.array([paths.farthest])
    return Packed(NodeArrays(paths.flexion, paths.loads, paths.parent, farthest))


@lru_cache(maxsize=8)
def _packed_contact(contact: ContactPoints) -> Packed:
    """The contact points, likewise."""
    return Packed(contact.arrays())


@lru_cache(maxsize=4)
def _packed_field(field: DistanceField) -> Packed:
    """The distance field, likewise."""
    return Packed(field.arrays())


def stability_margins(hessians: Array) -> Array:
    """Smallest eigenvalue of each Hessian [N/mm], rotations scaled by 40 mm; shape ``(n,)``."""
    scale = np.array([ROTATION_SCALE, ROTATION_SCALE, 1.0, 1.0, 1.0])
    return np.linalg.eigvalsh(hessians / scale[:, None] / scale)[:, 0]
