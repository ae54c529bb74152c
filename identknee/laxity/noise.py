"""Measurement noise of a stated size for simulated laxity."""

from dataclasses import replace

import numpy as np

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.table_file import correlation_fault
from identknee.runs.arrays import Array


def add_noise(
    laxity: Laxity,
    *,
    sd_mm: float,
    sd_deg: float,
    seed: int | np.random.SeedSequence,
    correlation: float = 0.0,
    student_degrees: float | None = None,
) -> Laxity:
    """`laxity` with random errors added and their size stated.

    The errors of a trial are ``sd * (L z)`` with ``L L' = (1 - r) I + r`` (Cholesky) and five
    independent standard draws ``z``, so that standard deviations and correlation are exact for
    either distribution; trials are independent. Coordinates not measured stay so, and do not change
    the errors of the others.

    Parameters
    ----------
    laxity
        Without noise so far.
    sd_mm, sd_deg
        Standard deviation of translations [mm] and rotations [deg], > 0.
    seed
        Whole number or seed sequence; the same seed gives the same errors.
    correlation
        What the five errors of a trial share, above -0.25 and below 1.
    student_degrees
        Degrees of freedom, > 2, of a Student t distribution scaled to the standard deviations: the
        fewer, the heavier its tails. Normal where None.

    Raises
    ------
    ValueError
        If a setting is out of range or `laxity` states a noise already.
    """
    for name, value in (("sd_mm", sd_mm), ("sd_deg", sd_deg)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be greater than 0 and finite, got {value:g}")
    if fault := correlation_fault(correlation):
        raise ValueError(". ".join(fault))
    if student_degrees is not None and not 2 < student_degrees < np.inf:
        raise ValueError(
            f"student_degrees must be greater than 2 for a finite spread, got {student_degrees:g}"
        )
    if laxity.sd is not None:
        raise ValueError("the laxity has standard deviations already: add noise once only")
    n_coordinates = len(COORDINATES)
    sd = np.empty((laxity.n, n_coordinates))
    sd[:, TRANSLATIONS], sd[:, ROTATIONS] = sd_mm, sd_deg
    shared = np.full((n_coordinates, n_coordinates), correlation)
    np.fill_diagonal(shared, 1.0)
    # Fixed loops instead of a matrix product, whose last bit depends on the machine's library.
    draws = _standard_draws(np.random.default_rng(seed), sd.shape, student_degrees)
    errors = np.einsum("ij,nj->ni", np.linalg.cholesky(shared), draws)
    return replace(
        laxity,
        coordinates=laxity.coordinates + sd * errors,
        sd=sd,
        within_trial_correlation=correlation,
    )


def _standard_draws(
    generator: np.random.Generator, shape: tuple[int, int], student_degrees: float | None
) -> Array:
    """Independent draws of mean 0 and variance 1."""
    if student_degrees is None:
        return generator.standard_normal(shape)
    scale = np.sqrt((student_degrees - 2) / student_degrees)
    return np.asarray(scale * generator.standard_t(student_degrees, shape))
