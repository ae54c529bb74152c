"""Parameters of a knee: those of ligaments and groups of ligaments, then of effects."""

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from identknee.model.effects.effect import joined
from identknee.model.effects.library import values_of
from identknee.model.mechanics_inputs import PER_KN, PER_PCT
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.runs.declare import Array, declared, entry, frozen
from identknee.subject.knee import Knee, StatedPrior


def with_priors(parameters: Parameters, priors: Mapping[str, StatedPrior]) -> Parameters:
    """A copy with other priors for the parameters named.

    Raises
    ------
    ValueError
        If a name is no parameter's, or a lognormal prior has no centre above 0.

    Examples
    --------
    >>> from identknee.model.parameters import ligament_parameters
    >>> everything = ligament_parameters(["ACL"], [10.0], [8.0])
    >>> with_priors(everything, {"ACL.stiffness_kN": StatedPrior(log_sd=0.5)}).prior_sd.tolist()
    [0.5, 2.0]
    """
    if not priors:
        return parameters
    center, prior_sd = np.array(parameters.center), np.array(parameters.prior_sd)
    is_log, start = np.array(parameters.is_log), np.array(parameters.start)
    for name, prior in priors.items():
        i = parameters.index(name)
        center[i] = start[i] if prior.center is None else prior.center
        prior_sd[i], is_log[i] = prior.spread, prior.is_log
        if prior.is_log and not center[i] > 0.0:
            raise ValueError(
                f"the lognormal prior of {name} needs a centre above 0, got {center[i]:g}"
            )
    return replace(parameters, center=center, prior_sd=prior_sd, is_log=is_log, own=start)


@declared
class ParameterGroups:
    """Units of calibration: a group of ligaments, or one, with one stiffness and one strain."""

    names: tuple[str, ...] = entry("Names of the u units, in the order of their first ligaments")
    member: Array = entry(
        "Which of the m ligaments belongs to which unit, 1 or 0, shape ``(m, u)``"
    )
    share: Array = entry("Stiffness of each ligament over that of its unit, shape ``(m,)``")
    offset: Array = entry("Reference strain of each less that of its unit [%], shape ``(m,)``")
    stiffness_kN: Array = entry("The knee's own stiffness of each unit: the sum, shape ``(u,)``")  # noqa: N815 - the unit
    reference_strain_pct: Array = entry(
        "The knee's own reference strain of each unit: the mean weighted by stiffness, shape "
        "``(u,)``"
    )
    by_stiffness: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "by_stiffness", self.member * self.share[:, None])

    @property
    def n(self) -> int:
        """Number of units."""
        return len(self.names)

    def stiffness(self, values: Array) -> Array:
        """Stiffness of each ligament from those of the units, shape ``(m,)``."""
        return np.asarray(self.by_stiffness @ values)

    def strain(self, values: Array) -> Array:
        """Reference strain of each ligament [%] from those of the units, shape ``(m,)``."""
        return np.asarray(self.member @ values + self.offset)

    def strain_upper_limits(self, strains: Array) -> Array:
        """The largest strain of each unit [%] at which no ligament exceeds `strains`, ``(u,)``."""
        allowed = np.where(self.member > 0.0, (strains - self.offset)[:, None], np.inf)
        return np.asarray(allowed.min(axis=0))


def tied(knee: Knee) -> ParameterGroups:
    """The units of calibration of a knee: its ligament groups, then each ligament in none.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> tied(reference_knee()).names
    ('ACL', 'PCL', 'LCL', 'MCL')
    """
    owners = knee.owners
    names = tuple(dict.fromkeys(owners))
    member = np.array([[float(owner == x) for x in names] for owner in owners])
    member = member.reshape(len(owners), len(names))
    stiffness = np.array([x.stiffness_kN for x in knee.ligaments])
    strain = np.array([x.reference_strain_pct for x in knee.ligaments])
    alone = member.sum(axis=0) == 1.0
    total = stiffness @ member
    # A stiffness of zero must not divide by zero where a ligament is its own unit.
    weights = np.where(member @ alone > 0.0, 1.0, stiffness / np.maximum(member @ total, 1e-300))
    mean = (weights * strain) @ member
    return ParameterGroups(
        names=names,
        member=frozen(member, None, None, name="members"),
        share=frozen(weights, None, name="shares"),
        offset=frozen(strain - member @ mean, None, name="offsets"),
        stiffness_kN=total,
        reference_strain_pct=mean,
    )


def knee_parameters(
    knee: Knee, units: ParameterGroups, amplitudes: Parameters | None
) -> Parameters:
    """Parameters of the ligaments, then the amplitudes, with priors, bounds and own values.

    Parameters
    ----------
    knee
        The subject.
    units
        Its units of calibration.
    amplitudes
        Amplitudes of the effects; None without effects.
    """
    parameters = ligament_parameters(
        units.names, units.stiffness_kN.tolist(), units.reference_strain_pct.tolist()
    )
    if amplitudes is not None:
        parameters = joined([parameters, amplitudes])
    known = set(parameters.names)
    priors = {name: x for name, x in knee.priors.items() if name in known}
    bounds = {name: x for name, x in knee.bounds.items() if name in known}
    stored = {**values_of(knee), **knee.fitted}
    own = {name: x for name, x in stored.items() if name in known}
    if own:
        parameters = replace(parameters, own=parameters.vector(own))
    return with_priors(parameters, priors).with_bounds(bounds)


def lines_by_units(owned: Array, share: Array, tied: ParameterGroups) -> Array:
    """Derivatives of the lines' stiffness [N] and strain by those of the units [kN, %].

    Shape ``(2m, 2u)``, stiffnesses first.
    """
    m, u = len(owned), tied.n
    units = np.zeros((2 * m, 2 * u))
    units[:m, :u] = PER_KN * ((owned * share[:, None]) @ tied.by_stiffness)
    units[m:, u:] = PER_PCT * (owned @ tied.member)
    return units
