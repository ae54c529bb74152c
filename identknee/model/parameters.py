"""The calibrated parameters: names, bounds, priors, and which of them are free or fixed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.declare import OF_PARAMETER, Array, BoolArray, array, declared, entry
from identknee.runs.errors import suggestion

STIFFNESS = "stiffness_kN"
STRAIN = "reference_strain_pct"


@declared
class Parameters:
    """Free parameters of a model, in the order of its parameter vector theta."""

    names: tuple[str, ...] = array(
        'Names such as "ACL.stiffness_kN", whose last word is the unit',
        "parameter",
        is_in_arrays=False,
    )
    center: Array = array(
        "Centre of the prior; also the subject's own values where these are not there",
        "parameter",
        unit=OF_PARAMETER,
    )
    lower: Array = array("Lower bound", "parameter", unit=OF_PARAMETER)
    upper: Array = array("Upper bound", "parameter", unit=OF_PARAMETER)
    prior_sd: Array = array(
        "Standard deviation of the prior; of the natural logarithm where that is normal",
        "parameter",
        unit=OF_PARAMETER,
    )
    is_log: BoolArray = array("Whether the prior is lognormal", "parameter", dtype=bool)
    is_nuisance: BoolArray | None = array(
        "Whether it stands for an error of what is given, with its prior; none does if missing",
        "parameter",
        dtype=bool,
        default=None,
    )
    own: Array | None = array(
        "The subject's own values where they are not the centre of the prior",
        "parameter",
        unit=OF_PARAMETER,
        default=None,
    )

    def __post_init__(self) -> None:
        if len(set(self.names)) != self.n:
            raise ValueError(f"parameter names must differ, got {self.names}")
        for name, low, high in zip(self.names, self.lower, self.upper, strict=True):
            if not low < high:
                raise ValueError(
                    f"the bounds of {name} must be lower < upper, got {low:g} and {high:g}"
                )

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.names)

    @property
    def is_of_interest(self) -> BoolArray:
        """Which are parameters of interest, not nuisances, shape ``(n,)``."""
        return np.ones(self.n, bool) if self.is_nuisance is None else ~self.is_nuisance

    @property
    def names_of_interest(self) -> tuple[str, ...]:
        """Names of the parameters of interest."""
        return tuple(x for x, asked in zip(self.names, self.is_of_interest, strict=True) if asked)

    @property
    def nuisance_names(self) -> tuple[str, ...]:
        """Names of the nuisances."""
        return tuple(
            x for x, asked in zip(self.names, self.is_of_interest, strict=True) if not asked
        )

    @property
    def start(self) -> Array:
        """The subject's own values, where a search starts by default, shape ``(n,)``."""
        return self.center if self.own is None else self.own

    def index(self, name: str) -> int:
        """Index of `name` in theta."""
        try:
            return self.names.index(name)
        except ValueError:
            message = f"there is no parameter {name!r}. {suggestion(name, self.names)}"
            raise ValueError(message) from None

    @property
    def prior_sd_in_own_units(self) -> Array:
        """Standard deviation of the prior around its centre, in the parameters' units."""
        return np.where(self.is_log, self.prior_sd * np.abs(self.center), self.prior_sd)

    def to_working(self, theta: Array) -> Array:
        """Working coordinates of thetas, shape ``(..., n)``: logarithms where priors are lognormal.

        In these coordinates every prior is normal, and the posterior is nearer to a normal density.
        """
        # A stiffness of 0 becomes minus infinity.
        with np.errstate(divide="ignore"):
            return np.where(self.is_log, np.log(np.where(self.is_log, theta, 1.0)), theta)

    def from_working(self, working: Array) -> Array:
        """Thetas from their working coordinates, shape ``(..., n)``."""
        # exp overflows just above 700, and such a value is outside all bounds.
        logs = np.minimum(np.where(self.is_log, working, 0.0), 700.0)
        return np.where(self.is_log, np.exp(logs), working)

    def vector(self, values: Mapping[str, float]) -> Array:
        """Theta with `values` by name and the subject's own for the rest."""
        theta = np.array(self.start)
        for name, value in values.items():
            theta[self.index(name)] = value
        return theta

    def select(self, names: Sequence[str]) -> "Parameters":
        """The parameters called `names`, in that order."""
        chosen = [self.index(name) for name in names]
        return Parameters(
            names=tuple(names),
            center=self.center[chosen],
            lower=self.lower[chosen],
            upper=self.upper[chosen],
            prior_sd=self.prior_sd[chosen],
            is_log=self.is_log[chosen],
            is_nuisance=None if self.is_nuisance is None else self.is_nuisance[chosen],
            own=None if self.own is None else self.own[chosen],
        )

    def with_fixed(self, names: Sequence[str], values: ArrayLike) -> "FreeParameters":
        """The parameters with those called `names` fixed at their entries of `values`, ``(n,)``.

        Raises
        ------
        ValueError
            If a name is not a parameter's.

        Examples
        --------
        >>> everything = ligament_parameters(["ACL"], [10.0], [8.0])
        >>> free = everything.with_fixed(["ACL.stiffness_kN"], everything.start)
        >>> free.parameters.names, free.expand(np.array([7.0])).tolist()
        (('ACL.reference_strain_pct',), [10.0, 7.0])
        """
        fixed = {self.index(name) for name in names}
        return FreeParameters(
            everything=self,
            free_indices=tuple(i for i in range(self.n) if i not in fixed),
            fixed_values=np.asarray(values),
        )

    def with_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> "Parameters":
        """A copy with other bounds for the parameters named."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        for name, (low, high) in bounds.items():
            lower[self.index(name)], upper[self.index(name)] = low, high
        return replace(self, lower=lower, upper=upper)

    def as_nuisances(self) -> "Parameters":
        """A copy in which all are nuisances."""
        return replace(self, is_nuisance=np.ones(self.n, bool))


@declared
class FreeParameters:
    """Which of a model's parameters are free, and what the others are fixed at."""

    everything: Parameters = entry("All parameters of the model, in the order of its theta")
    free_indices: tuple[int, ...] = entry("Places of the free ones in that theta")
    fixed_values: Array = array(
        "Values of all parameters, of which the fixed ones keep theirs", "parameter"
    )

    def __post_init__(self) -> None:
        if self.fixed_values.size != self.everything.n:
            raise ValueError(
                f"there must be a value for each of {self.everything.n} parameters, "
                f"got {self.fixed_values.size}"
            )

    @property
    def parameters(self) -> Parameters:
        """The free parameters."""
        return self.everything.select([self.everything.names[i] for i in self.free_indices])

    def expand(self, theta: ArrayLike) -> Array:
        """Theta of all parameters from that of the free ones, shape ``(..., p)``."""
        free = np.asarray(theta)
        values = np.array(np.broadcast_to(self.fixed_values, (*free.shape[:-1], self.everything.n)))
        values[..., list(self.free_indices)] = free
        return values

    def restrict(self, values: Array) -> Array:
        """The entries of the free parameters in values ``(..., p)`` of all parameters."""
        return np.asarray(values[..., list(self.free_indices)])


def ligament_parameters(
    ligaments: Sequence[str], stiffness_kN: Sequence[float], reference_strain_pct: Sequence[float]
) -> Parameters:
    """Parameters of line ligaments: stiffness and reference strain of each.

    Theta holds the stiffnesses of all ligaments first, then their reference strains. The box is
    0 to 40 kN and -15 to 15 %; the prior is lognormal around the subject's stiffness with log-sd
    0.35 and normal around its reference strain with sd 2 %.

    Examples
    --------
    >>> ligament_parameters(["ACL"], [10.0], [8.0]).names
    ('ACL.stiffness_kN', 'ACL.reference_strain_pct')
    """
    n = len(ligaments)
    return Parameters(
        names=(*(f"{x}.{STIFFNESS}" for x in ligaments), *(f"{x}.{STRAIN}" for x in ligaments)),
        center=np.r_[np.asarray(stiffness_kN, float), np.asarray(reference_strain_pct, float)],
        lower=np.r_[np.zeros(n), np.full(n, -15.0)],
        upper=np.r_[np.full(n, 40.0), np.full(n, 15.0)],
        prior_sd=np.r_[np.full(n, 0.35), np.full(n, 2.0)],
        is_log=np.arange(2 * n) < n,
    )
