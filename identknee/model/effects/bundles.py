"""Bundles: fibres of one ligament that do not tighten together."""

from dataclasses import replace

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.model.effects.changes import SettingChange
from identknee.model.effects.effect import amplitudes
from identknee.model.setting import Setting, with_shares
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

SPREAD_SD, SPREAD_LIMIT = 5.0, 30.0  # %


def bundles(knee: Knee) -> SettingChange:
    """Two bundles in place of every ligament, their reference strains a spread apart [%].

    Each has half of the stiffness, the first half of the spread more strain than the ligament and
    the second half of it less. Bundles of published models differ by 4 % (anterior cruciate) to
    21 % (posterior cruciate) and 33 % (lateral collateral) [1]_. Which bundle is the tauter one
    cannot be told apart, so that the first derivative at zero spread is zero.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    names = [f"{x.name}_strain_spread_pct" for x in knee.ligaments]
    n = len(names)
    made = amplitudes("bundles", names, n * [SPREAD_SD], lower=n * [0.0], upper=n * [SPREAD_LIMIT])
    return SettingChange(name="bundles", parameters=made, changed=_split)


def _split(setting: Setting, values: Array) -> Setting:
    own = np.flatnonzero(setting.owner >= 0)
    owner, lines = setting.owner[own], setting.lines
    half_spread = 0.005 * values[owner]
    halved = np.where(setting.owner >= 0, 0.5, 1.0)
    strain = np.array(setting.reference_strain)
    strain[own] += half_spread
    first = replace(
        setting,
        stiffness=halved * setting.stiffness,
        share=halved * setting.share,
        reference_strain=strain,
    )
    second = Lines(
        femoral=lines.femoral[own],
        tibial=lines.tibial[own],
        reference_length=lines.reference_length[own],
        transition=np.asarray(lines.transition)[own],
        lift=np.asarray(lines.lift)[own],
        lift_place=np.asarray(lines.lift_place)[own],
    )
    slacker = setting.reference_strain[own] - half_spread
    return with_shares(first, second, slacker, owner, first.share[own])
