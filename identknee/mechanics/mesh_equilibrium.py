"""Equilibria under the paper's mesh contact: damped Newton steps along load paths.

The law's force jumps where a vertex changes its closest triangle, so a pose with no residual need
not exist; the search then ends at the smallest residual it saw and says so.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.mechanics.ligament_wrench import ligament_wrench
from identknee.mechanics.load_paths import LoadPaths
from identknee.mechanics.memory import ROTATION_SCALE
from identknee.mechanics.mesh_contact import MeshContact
from identknee.mechanics.placement import place
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry
from identknee.runs.outcome import Outcome

RESIDUAL_TOLERANCE = 1e-3  # N, the paper's; moments divided by the rotation scale
MOST_ITERATIONS = 40
MOST_HALVINGS = 6
LONGEST_STEP = 3.0  # mm, rotations multiplied by the rotation scale
LEAST_STIFFNESS = 0.5  # N/mm; below it the step would be decided by noise
_SCALE = np.array([ROTATION_SCALE, ROTATION_SCALE, 1.0, 1.0, 1.0])

# Residual (5,) and stiffness (5, 5) at a pose (5,).
_Balance = Callable[[Array], tuple[Array, Array]]


@declared
class MeshEquilibria:
    """What the search found for each trial."""

    poses: Array = array(
        "The pose of the smallest residual: varus, internal [rad], x, y, z [mm]", "trial", "5"
    )
    residuals: Array = array("Residuals, moments divided by 40 mm", "trial", unit="N")
    outcomes: tuple[Outcome, ...] = entry(
        "``CONVERGED`` where the residual is at most 0.001 N, else ``NO_EQUILIBRIUM``: usually the "
        "law jumps across zero there"
    )
    evaluations: IntArray = array(
        "Contact evaluations on the last step of the way to each trial", "trial", dtype=int
    )


def mesh_equilibria(
    paths: LoadPaths,
    start: Array,
    contact: MeshContact,
    lines: Lines,
    stiffness: Array,
    reference_strain: Array,
) -> MeshEquilibria:
    """The equilibria of the trials of `paths`, each reached from its parent on the path.

    Parameters
    ----------
    paths
        Flexion and generalised loads of (varus, internal [N mm], x, y, z [N]) in small steps, as
        `identknee.mechanics.load_paths.load_paths` makes them.
    start
        Pose where the paths begin: varus, internal [rad], x, y, z [mm], shape ``(5,)``, or one for
        each node, ``(n_nodes, 5)``.
    contact
        The meshes and whose vertices count.
    lines
        Insertions and reference lengths of the m ligaments.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    n_nodes = len(paths.flexion)
    poses, residuals = np.empty((n_nodes, 5)), np.empty(n_nodes)
    evaluations = np.empty(n_nodes, np.int64)
    starts = np.broadcast_to(start, (n_nodes, 5))
    for node in range(n_nodes):
        parent = int(paths.parent[node])
        balance = partial(
            _balance,
            flexion=float(paths.flexion[node]),
            load=paths.loads[node],
            contact=contact,
            ligaments=(lines, stiffness, reference_strain),
        )
        first = starts[node] if parent < 0 else poses[parent]
        poses[node], residuals[node], evaluations[node] = _search(balance, first)
    chosen = paths.trial_node
    return MeshEquilibria(
        poses=poses[chosen],
        residuals=residuals[chosen],
        outcomes=tuple(
            Outcome.CONVERGED if residuals[node] <= RESIDUAL_TOLERANCE else Outcome.NO_EQUILIBRIUM
            for node in chosen
        ),
        evaluations=evaluations[chosen],
    )


def _balance(
    pose: Array,
    *,
    flexion: float,
    load: Array,
    contact: MeshContact,
    ligaments: tuple[Lines, Array, Array],
) -> tuple[Array, Array]:
    placement = place(flexion, pose)
    pressed = contact.wrench(placement)
    pulled = ligament_wrench(placement, *ligaments)
    return pressed.force + pulled.force + load, pressed.stiffness + pulled.stiffness


def _search(balance: _Balance, start: Array) -> tuple[Array, float, int]:
    """The pose of the smallest residual met, that residual [N], and the evaluations made."""
    pose = np.array(start, float)
    residual, stiffness = balance(pose)
    size = _size(residual)
    evaluations = 1
    for _ in range(MOST_ITERATIONS):
        if size <= RESIDUAL_TOLERANCE:
            break
        step = _newton_step(residual, stiffness)
        for halving in range(MOST_HALVINGS + 1):
            trial = pose + step * 0.5**halving
            trial_residual, trial_stiffness = balance(trial)
            evaluations += 1
            if _size(trial_residual) < size:
                break
        else:
            # No shorter step helps: the force jumps here.
            break
        pose, residual, stiffness = trial, trial_residual, trial_stiffness
        size = _size(residual)
    return pose, size, evaluations


def _newton_step(residual: Array, stiffness: Array) -> Array:
    """The step that balances `residual` were the law linear, stiffened and shortened for safety."""
    scaled = stiffness / _SCALE / _SCALE[:, None]
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(np.abs(values), LEAST_STIFFNESS)
    step = vectors @ ((vectors.T @ (residual / _SCALE)) / values)
    step *= min(1.0, LONGEST_STEP / max(float(np.linalg.norm(step)), 1e-300))
    shortened: Array = step / _SCALE
    return shortened


def _size(residual: Array) -> float:
    return float(np.linalg.norm(residual / _SCALE))
