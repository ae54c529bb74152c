"""A prior that a subject states for one of its parameters."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedPrior:
    """What is known of a parameter before any test.

    Attributes
    ----------
    sd
        Standard deviation in the parameter's unit, of a normal prior; None for a lognormal one.
    log_sd
        Standard deviation of the natural logarithm, of a lognormal prior; None for a normal one.
    center
        Middle of the prior in the parameter's unit; the subject's own value where None.

    Raises
    ------
    ValueError
        If not exactly one of both is given, or it is not greater than 0.
    """

    sd: float | None = None
    log_sd: float | None = None
    center: float | None = None

    def __post_init__(self) -> None:
        if (self.sd is None) == (self.log_sd is None):
            raise ValueError("a prior has either sd or log_sd; give one of the two")
        if not 0.0 < self.spread < float("inf"):
            raise ValueError(f"the spread of a prior must be greater than 0, got {self.spread:g}")
        if self.is_log and self.center is not None and not self.center > 0.0:
            raise ValueError(
                f"the centre of a lognormal prior must be greater than 0, got {self.center:g}"
            )

    @property
    def is_log(self) -> bool:
        """Whether it is lognormal."""
        return self.log_sd is not None

    @property
    def spread(self) -> float:
        """The standard deviation that was given."""
        return float((self.sd if self.log_sd is None else self.log_sd) or 0.0)
