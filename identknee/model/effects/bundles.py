"""Bundles: fibres of one ligament that do not tighten together."""

from dataclasses import replace

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.model.effects.effect import ReplicaInputsChange, amplitudes, with_remeasured_lengths
from identknee.model.effects.insertion import AXES, BONES
from identknee.model.mechanics_inputs import PER_PCT, MechanicsInputs
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

SPREAD_SD, SPREAD_LIMIT = 5.0, 30.0  # %
PLACE_SD, PLACE_LIMIT = 4.0, 16.0  # mm


def bundles(knee: Knee) -> ReplicaInputsChange:
    """Two bundles in place of every ligament, a spread apart in reference strain and in place.

    Each has half of the stiffness; the first half of the spread [%] more strain than the ligament
    and, along the axes of its bone, half of the distance [mm] between their insertions to one side,
    the second as much less and to the other side. Reference lengths are those between the bundles'
    own insertions in the scanned pose. Bundles of published models differ by 4 % (anterior
    cruciate) to 21 % (posterior cruciate) and 33 % (lateral collateral) [1]_; distances of 4 mm are
    an estimate. Without a spread in strain nothing changes to first order in either.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    strains = [f"{x.name}_strain_spread_pct" for x in knee.ligaments]
    places = [
        f"{ligament.name}_{bone}_{axis}_spread_mm"
        for ligament in knee.ligaments
        for bone in BONES
        for axis in AXES
    ]
    n, m = len(strains), len(places)
    made = amplitudes(
        "bundles",
        strains + places,
        n * [SPREAD_SD] + m * [PLACE_SD],
        lower=n * [0.0] + m * [-PLACE_LIMIT],
        upper=n * [SPREAD_LIMIT] + m * [PLACE_LIMIT],
    )
    return ReplicaInputsChange(name="bundles", parameters=made, changed=_split)


def _split(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    is_own, lines = setting.owner >= 0, setting.lines
    # Every line, then the second bundles of those that belong to a ligament.
    line = np.r_[np.arange(is_own.size), np.flatnonzero(is_own)]
    owner = setting.owner[line]
    side = np.where(owner >= 0, 0.5, 0.0)
    side[is_own.size :] *= -1.0
    n = values.shape[-1] // (1 + len(BONES) * len(AXES))
    each = values if values.ndim > 1 else values[None]
    row = setting.copy[line] if values.ndim > 1 else np.zeros(line.size, int)
    strains, places = each[:, :n], each[:, n:].reshape(-1, n, len(BONES), len(AXES))
    aside = side[:, None, None] * places[row, owner]
    half = np.where(owner >= 0, 0.5, 1.0)
    bundled = LineLigaments(
        femoral=lines.femoral[line] + aside[:, 0],
        tibial=lines.tibial[line] + aside[:, 1],
        reference_length=lines.reference_length[line],
        transition=np.asarray(lines.transition)[line],
        wrap_offset=np.asarray(lines.wrap_offset)[line],
        wrap_place=np.asarray(lines.wrap_place)[line],
    )
    split = replace(
        setting,
        stiffness=half * setting.stiffness[line],
        reference_strain=setting.reference_strain[line] + PER_PCT * side * strains[row, owner],
        owner=owner,
        share=half * setting.share[line],
        copy=setting.copy[line],
    )
    return with_remeasured_lengths(split, bundled, owner >= 0)
