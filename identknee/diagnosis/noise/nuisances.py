"""What nobody wants named: errors of the surfaces and of the law of ligaments, as nuisances."""

import numpy as np

from identknee.model.effects.toe_strain import toe_strain
from identknee.model.laxity_model import LaxityModel
from identknee.model.shared_errors import has_shared_errors, shared_errors
from identknee.model.surface_errors import surface_changes
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

LENGTH = 3.0  # mm, of a bump
# mm; how far the surfaces of a model are from those of the knee, bump by bump: where they are given
# by a formula only their sampling is rough, a mesh has also been segmented and smoothed.
FORMULA_ROUGHNESS, MESH_ROUGHNESS = 0.01, 0.02
TOE = 0.15  # %; how well any formula of the toe region describes ligaments


def nuisance_changes(model: LaxityModel, theta: Array) -> tuple[Array, Array]:
    """What nuisances change in the coordinates of all trials, and their prior spreads.

    Rough surfaces, a force-strain curve whose toe is not quite the one of the equations, unless
    that is one of the model's effects, and the shared errors that the knee states.

    Returns
    -------
    changes
        For a nuisance of 1, shape ``(n, 5, k)``; NaN in trials that did not converge.
    spreads
        Prior standard deviation of each, shape ``(k,)``.
    """
    rough = surface_changes(model, model.predict_once(theta), LENGTH)
    heights = np.full(rough.shape[2], roughness_of(model.knee))
    changes, spreads = [rough], [heights]
    toe = toe_strain()
    if toe.name not in {x.name for x in model.effects}:
        found = model.with_effects([*model.effects, toe]).predict(np.r_[theta, 0.0])
        if found.jacobian is None:  # pragma: no cover - it was asked for
            raise AssertionError
        changes.append(found.jacobian[:, :, -1:])
        spreads.append(np.array([TOE]))
    if has_shared_errors(model.knee.uncertainty):
        shared = shared_errors(model, theta)
        changes.append(shared)
        spreads.append(np.ones(shared.shape[2]))
    return np.concatenate(changes, axis=2), np.concatenate(spreads)


def roughness_of(knee: Knee) -> float:
    """How far the surfaces of a model are from those of the knee [mm], bump by bump."""
    return MESH_ROUGHNESS if knee.femur_distance is None else FORMULA_ROUGHNESS
