"""How the gradient of the energy at fixed poses changes from one setting to another."""

from collections.abc import Sequence

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.mechanics.memory import Equilibria
from identknee.model.setting import Setting
from identknee.runs.arrays import Array, IntArray

Pair = tuple[Setting, Setting]


def gradient_changes(
    pairs: Sequence[Pair], flexion: Array, found: Equilibria, nodes: IntArray
) -> Array:
    """Changes from the first to the second setting of each pair, shape ``(n, 5, k)``.

    Parameters
    ----------
    pairs
        The k pairs, close to the setting under which the equilibria were found.
    flexion
        Flexion of each trial [rad], shape ``(n,)``.
    found
        The equilibria at the nodes, made under a stated contact law.
    nodes
        The node of each trial, shape ``(n,)``.
    """
    changes = _line_changes(pairs, flexion, found.poses[nodes])
    for k, (low, high) in enumerate(pairs):
        changes[:, :, k] += low.loads[nodes] - high.loads[nodes]
        changes[:, :, k] += (
            found.gradient_by_flexion[nodes] * (high.flexion - low.flexion)[nodes][:, None]
        )
        law = np.array(
            [np.log(high.law.modulus / low.law.modulus), high.law.exponent - low.law.exponent]
        )
        if law.any():
            # The sensitivities are -H^-1 times the columns that are wanted here.
            shift = found.sensitivities[nodes][:, :, -2:] @ law
            changes[:, :, k] -= np.einsum("nij,nj->ni", found.hessians[nodes], shift)
    return changes


def _line_changes(pairs: Sequence[Pair], flexion: Array, poses: Array) -> Array:
    """The part of the lines: those alone that change, of all pairs at once."""
    rows, signs = [], []
    for k, (low, high) in enumerate(pairs):
        if low.lines is high.lines and low.stiffness is high.stiffness:
            continue
        tables = _table(low), _table(high)
        changed = np.any(tables[0] != tables[1], axis=1)
        for table, sign in zip(tables, (-1.0, 1.0), strict=True):
            rows.append(table[changed])
            signs.append(np.outer(np.full(changed.sum(), sign), np.arange(len(pairs)) == k))
    if not rows:
        return np.zeros((len(poses), 5, len(pairs)))
    table = np.concatenate(rows)
    lines = Lines(
        femoral=table[:, :3],
        tibial=table[:, 3:6],
        reference_length=table[:, 6],
        transition=table[:, 7],
        wrap_offset=table[:, 8],
        wrap_place=table[:, 9],
    )
    found = ligament_tensions(lines, flexion, poses, table[:, 10], table[:, 11])
    gradients = found.tensions[:, :, None] * found.lengthening
    return np.asarray(np.swapaxes(gradients, 1, 2) @ np.concatenate(signs))


def _table(setting: Setting) -> Array:
    """All that the gradient of each line depends on, shape ``(m, 12)``."""
    x = setting.lines
    courses = (x.reference_length, x.transition, x.wrap_offset, x.wrap_place)
    laws = (setting.stiffness, setting.reference_strain)
    return np.column_stack([x.femoral, x.tibial, *courses, *laws])
