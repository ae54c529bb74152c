"""Equilibria of a set of trials: the kernel's door for the rest of the package."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from identknee.mechanics import kernel
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.load_paths import LoadPaths
from identknee.mechanics.small_matrices import scale_of
from identknee.runs.arrays import Array, IntArray, frozen, frozen_integers

PRESSURE_MODULUS = 10.0  # N/mm3, the paper's 10 GN/m3
TRANSITION_STRAIN = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactLaw:
    """Pressure of the contact, ``modulus depth (depth / REFERENCE_DEPTH)^(exponent - 1)``.

    Attributes
    ----------
    modulus
        [N/mm3], > 0.
    exponent
        Of the depth, > 0; the paper's law has 1.
    """

    modulus: float = PRESSURE_MODULUS
    exponent: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactPoints:
    """Points of the tibial surface that carry contact, in tibial axes.

    Attributes
    ----------
    points
        [mm], shape ``(n, 3)``.
    areas
        Tributary areas [mm2], shape ``(n,)``.
    compartment
        Which tibial surface each belongs to, shape ``(n,)``.
    law
        The contact law, with sensitivities to it; the paper's, without them, where None.
    """

    points: Array
    areas: Array
    compartment: IntArray
    law: ContactLaw | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        object.__setattr__(self, "points", frozen(self.points, n, 3, name="points"))
        object.__setattr__(self, "areas", frozen(self.areas, n, name="areas"))
        object.__setattr__(self, "compartment", frozen_integers(self.compartment))

    @property
    def n_compartments(self) -> int:
        """How many tibial surfaces there are."""
        return int(self.compartment.max()) + 1

    def arrays(self) -> tuple[Array, Array, Array, IntArray, Array]:
        """The points as the kernel takes them."""
        law = self.law or ContactLaw()
        radius = np.array([np.linalg.norm(self.points, axis=1).max()])
        return (
            np.ascontiguousarray(self.points.T),
            radius,
            law.modulus * self.areas,
            self.compartment,
            np.array([law.exponent]),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lines:
    """Line ligaments: insertions in femoral and tibial axes, and what does not change in a fit.

    Attributes
    ----------
    femoral, tibial
        Insertions [mm], shape ``(m, 3)``.
    reference_length
        Length in the scanned pose [mm], shape ``(m,)``.
    transition
        Strain at which the force-strain curve has half its final slope, shape ``(m,)``; negative
        for a spring, linear in tension and compression.
    lift
        How far something pushes each line aside, towards femoral z [mm], shape ``(m,)``.
    lift_place
        Where it does, as a share of the way from the tibia to the femur, shape ``(m,)``.
    """

    femoral: Array
    tibial: Array
    reference_length: Array
    transition: Array | float = TRANSITION_STRAIN
    lift: Array | float = 0.0
    lift_place: Array | float = 0.5

    def __post_init__(self) -> None:
        m = len(self.femoral)
        for name in ("femoral", "tibial"):
            object.__setattr__(self, name, frozen(getattr(self, name), m, 3, name=name))
        for name in ("reference_length", "transition", "lift", "lift_place"):
            values = getattr(self, name)
            values = np.full(m, values) if np.ndim(values) == 0 else values
            object.__setattr__(self, name, frozen(values, m, name=name))

    def arrays(self, stiffness: Array, reference_strain: Array) -> tuple[Array, Array, Array]:
        """The ligaments with stiffness [N] and reference strain, as the kernel takes them."""
        course = (self.reference_length, self.transition, self.lift, self.lift_place)
        columns = [np.asarray(x, float) for x in (stiffness, reference_strain, *course)]
        return self.femoral, self.tibial, np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equilibria:
    """What the kernel found at every node of the load paths.

    Attributes
    ----------
    poses
        Last stable pose on the way to each node: varus, internal [rad], x, y, z [mm], ``(n, 5)``.
    hessians
        Second derivatives of the energy there, ``(n, 5, 5)``.
    sensitivities
        d pose / d (stiffness [N], reference strain), ``(n, 5, 2m)``; under a stated contact law
        also d pose / d (logarithm of the modulus, exponent), ``(n, 5, 2m + 2)``. Zero where not
        converged.
    flexed
        d gradient of the energy / d flexion, shape ``(n, 5)``.
    codes
        Outcome codes of the kernel, ``(n,)``.
    reached
        Share of the step from the parent that was reached, ``(n,)``.
    centres
        Contact force [N], its centre in tibial and femoral axes [mm], ``(n, compartments, 7)``.
    solves
        Equilibrium searches made for each node, ``(n,)``.
    """

    poses: Array
    hessians: Array
    sensitivities: Array
    flexed: Array
    codes: IntArray
    reached: Array
    centres: Array
    solves: IntArray


def solve(
    paths: LoadPaths,
    start: Array,
    contact: ContactPoints,
    field: DistanceField,
    ligaments: tuple[Array, Array, Array],
    *,
    derivatives: bool = True,
    guesses: Array | None = None,
) -> Equilibria:
    """The equilibria at the nodes of `paths`, beginning the search at the pose `start` (5,).

    Parameters
    ----------
    guesses
        Poses to try first, shape ``(n_nodes, 5)``. A guess is kept only if the equilibrium found
        from it agrees with its neighbour's tangents, as one found without must.
    """
    n, m = len(paths.flexion), len(ligaments[0])
    codes, solves = np.full(n, kernel.NO_EQUILIBRIUM), np.zeros(n, np.int64)
    poses, hessians, slopes = (
        np.zeros((n, 5)),
        np.zeros((n, 5, 5)),
        np.zeros((n, 5, 2 * m + 2 * (contact.law is not None))),
    )
    residuals, reached, flexed = np.zeros(n), np.zeros(n), np.zeros((n, 5))
    centres = np.zeros((n, contact.n_compartments, 7))
    kernel.simulate_path(
        _read_only(paths.flexion, paths.loads, paths.parent),
        np.array(start, float),
        np.zeros((n, 5)) if guesses is None else np.array(guesses),
        guesses is not None,
        _read_only(*contact.arrays()),
        _read_only(*field.arrays()),
        _read_only(*ligaments),
        derivatives,
        (poses, hessians, slopes, codes, residuals, reached, flexed, solves, centres),
    )
    return Equilibria(
        poses=poses,
        hessians=hessians,
        sensitivities=slopes,
        flexed=flexed,
        codes=codes,
        reached=reached,
        centres=centres,
        solves=solves,
    )


def _read_only(*values: Any) -> tuple[Any, ...]:
    """The same values, arrays as views that cannot be written to.

    The compiler takes arrays that can be written to for another type, and pickling makes read-only
    arrays writable: without this a model sent to another process would be compiled once more, and
    might differ in the last bit.
    """
    views = []
    for value in values:
        view = value
        if isinstance(value, np.ndarray):
            view = value.view()
            view.flags.writeable = False
        views.append(view)
    return tuple(views)


def stability_margins(hessians: Array) -> Array:
    """Smallest eigenvalue of each Hessian [N/mm], rotations scaled by 40 mm; shape ``(n,)``."""
    scale = np.array([scale_of(i) for i in range(5)])
    return np.linalg.eigvalsh(hessians / scale[:, None] / scale)[:, 0]
