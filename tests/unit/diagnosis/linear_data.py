"""A protocol of 63 trials and random linear fits to it, for statistics that need no knee."""

from dataclasses import dataclass

import numpy as np

from identknee.checks.data_noise import Curve
from identknee.diagnosis.misfit import Projector, base_projector
from identknee.diagnosis.noise_model import NoiseModel, build_noise_model
from identknee.diagnosis.score import Signature
from identknee.runs.declare import Array, BoolArray

FLEXIONS = (0.0, 30.0, 60.0)
LEVELS = np.arange(-10.0, 11.0, 2.0)
N_PARAMETERS = 8


def protocol() -> tuple[Array, Array, list[Curve]]:
    """Flexion (63,), two loads (63, 2), and six curves that share the unloaded trials."""
    flexion: list[float] = []
    loads: list[tuple[float, float]] = []
    curves = []
    for angle in FLEXIONS:
        zero = len(flexion)
        flexion.append(angle)
        loads.append((0.0, 0.0))
        for axis in range(2):
            rows = []
            for level in LEVELS:
                if level == 0:
                    rows.append(zero)
                    continue
                rows.append(len(flexion))
                flexion.append(angle)
                loads.append((level, 0.0) if axis == 0 else (0.0, level))
            curves.append(Curve(trials=np.array(rows), load=LEVELS))
    return np.array(flexion), np.array(loads), curves


def everything() -> BoolArray:
    return np.ones((63, 5), dtype=bool)


def unit_noise(correlation: float = 0.3) -> NoiseModel:
    return build_noise_model(np.ones((63, 5)), everything(), correlation=correlation)


@dataclass(frozen=True)
class LinearFit:
    """Whitened derivatives of a fit with a sloppy direction, prior rows included."""

    jacobian: Array
    projector: Projector

    @property
    def n_data(self) -> int:
        return len(self.jacobian) - N_PARAMETERS

    def residuals(self, generator: np.random.Generator, n: int) -> Array:
        """Of n data sets of noise alone."""
        return generator.standard_normal((n, len(self.jacobian)))


def linear_fit(seed: int = 0, n_data: int = 315) -> LinearFit:
    generator = np.random.default_rng(seed)
    scales = np.geomspace(3.0, 0.02, N_PARAMETERS)
    data = generator.standard_normal((n_data, N_PARAMETERS)) * scales
    jacobian = np.vstack([data, np.eye(N_PARAMETERS) / 3])
    return LinearFit(jacobian=jacobian, projector=base_projector(jacobian))


def signature(
    columns: Array, name: str, *, variant: str = "", sign: int = 0, prior_sd: float = 1.0
) -> Signature:
    """One prior and sign for all amplitudes."""
    k = columns.shape[1]
    return Signature(
        name=name,
        variant=variant,
        columns=columns,
        prior_sd=np.full(k, prior_sd),
        sign=np.full(k, sign),
    )


def library(seed: int, n_data: int = 315) -> list[Signature]:
    """Effects with one amplitude, of one sign or either, with many, and with a grid of variants."""
    generator = np.random.default_rng(seed)
    found = [
        signature(generator.standard_normal((n_data, 1)), f"plain{i}", sign=i % 2)
        for i in range(10)
    ]
    found += [
        signature(generator.standard_normal((n_data, 8)), f"many{i}", prior_sd=0.2)
        for i in range(3)
    ]
    found.append(signature(generator.standard_normal((n_data, 2)), "pair", sign=1))
    middle = generator.standard_normal((n_data, 1))
    found += [
        signature(middle + 0.5 * generator.standard_normal((n_data, 1)), "grid", variant=str(i))
        for i in range(12)
    ]
    return found
