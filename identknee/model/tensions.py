"""Ligament forces of a prediction, with exact derivatives."""

import numpy as np

from identknee.mechanics.ligament_tensions import LigamentTensions, ligament_tensions
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.setting import PER_KN, PER_PCT, Setting
from identknee.runs.arrays import Array


def tensions_of(model: LaxityModel, prediction: Prediction) -> Array:
    """Tension of every ligament in every trial [N], shape ``(n, n_ligaments)``.

    That of all its lines where an effect splits it into bundles. NaN in trials that did not
    converge.
    """
    setting = model.setting(prediction.theta)
    lines = _lines(model, setting, prediction)
    tensions: Array = lines.tensions @ setting.owned(len(model.knee.ligaments))
    tensions[~prediction.is_converged] = np.nan
    return tensions


def tension_jacobian(model: LaxityModel, prediction: Prediction) -> Array:
    """Exact derivatives of `tensions_of` by theta, shape ``(n, n_ligaments, p)``.

    In N per unit of each parameter: it changes a tension directly and by moving the tibia. NaN in
    trials that did not converge.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    if prediction.pose_jacobian is None:
        raise ValueError("tensions have derivatives only where the prediction has them")
    setting, m = model.setting(prediction.theta), len(model.knee.ligaments)
    found, owned = _lines(model, setting, prediction), setting.owned(m)
    by_pose = np.einsum("nla,lm->nma", found.by_pose, owned)
    jacobian: Array = by_pose @ np.nan_to_num(prediction.pose_jacobian)
    own = np.arange(m)
    jacobian[:, own, own] += PER_KN * (found.by_stiffness * setting.share) @ owned
    jacobian[:, own, m + own] += PER_PCT * found.by_strain @ owned
    unchanged = model.setting(prediction.theta, is_changed=False)
    amplitudes = model.amplitudes(prediction.theta)
    for k, move in enumerate(model.extension.moves()):
        low, high = (
            _lines(model, model.extension.change(unchanged, amplitudes + s * move), prediction)
            for s in (-1.0, 1.0)
        )
        jacobian[:, :, 2 * m + k] += (high.tensions - low.tensions) @ owned / (2.0 * move[k])
    jacobian[~prediction.is_converged] = np.nan
    return jacobian


def _lines(model: LaxityModel, setting: Setting, prediction: Prediction) -> LigamentTensions:
    """Tensions of all lines at the poses of a prediction."""
    return ligament_tensions(
        setting.measured_lines,
        setting.flexion[model.paths.trial_node],
        prediction.poses,
        setting.stiffness,
        setting.reference_strain,
    )
