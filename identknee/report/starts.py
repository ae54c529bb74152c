"""Fits of one synthetic data set from several starts, beside the parameters that made the data."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from identknee.calibrate.fit import Fit
from identknee.laxity.rmse import laxity_rmse
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.report.comparison import parameter_error
from identknee.runs.arrays import Array, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StartRow:
    """What one method made of one start, in one run or several.

    Attributes
    ----------
    start
        Name of the start.
    fits
        One a run.
    error_kN, error_pct
        Mean absolute error of the stiffnesses [kN] and of the reference strains [%] of each run,
        shape ``(n_runs,)``.
    rmse_mm, rmse_deg
        Root-mean-square error of the laxity of each run [mm], [deg], shape ``(n_runs,)``.
    """

    start: str
    fits: tuple[Fit, ...]
    error_kN: Array  # noqa: N815 - the unit
    error_pct: Array
    rmse_mm: Array
    rmse_deg: Array

    def __post_init__(self) -> None:
        for name in ("error_kN", "error_pct", "rmse_mm", "rmse_deg"):
            object.__setattr__(self, name, frozen(getattr(self, name), self.n_runs, name=name))

    @property
    def method(self) -> str:
        """The method of all runs."""
        return self.fits[0].method

    @property
    def n_runs(self) -> int:
        """How many runs there are."""
        return len(self.fits)

    def to_dict(self) -> dict[str, Any]:
        """Medians over the runs, and how they ended, in plain types."""
        return {
            "start": self.start,
            "method": self.method,
            "n_runs": self.n_runs,
            "outcomes": dict(Counter(x.outcome.value for x in self.fits)),
            "error": {
                "kN": float(np.median(self.error_kN)),
                "pct": float(np.median(self.error_pct)),
            },
            "rmse": {
                "mm": float(np.median(self.rmse_mm)),
                "deg": float(np.median(self.rmse_deg)),
            },
            "n_simulations": float(np.median([x.n_simulations for x in self.fits])),
            "seconds": float(np.median([x.seconds for x in self.fits])),
        }


def start_row(
    start: str, fits: Sequence[Fit], truth: Array, model: LaxityModel, laxity: Laxity
) -> StartRow:
    """The errors of fits from one start.

    Parameters
    ----------
    start
        Its name.
    fits
        One a run, at least one.
    truth
        The parameters that made the data, shape ``(p,)``.
    model, laxity
        The model and the data that were fitted.
    """
    errors = [parameter_error(fit.theta, truth) for fit in fits]
    rmses = [laxity_rmse(model.simulate(fit.theta), laxity) for fit in fits]
    return StartRow(
        start=start,
        fits=tuple(fits),
        error_kN=np.array([x.mean_kN for x in errors]),
        error_pct=np.array([x.mean_pct for x in errors]),
        rmse_mm=np.array([x.mm for x in rmses]),
        rmse_deg=np.array([x.deg for x in rmses]),
    )


def starts_table(rows: Iterable[StartRow]) -> list[str]:
    """The rows as lines of text, medians over the runs."""
    head = f"{'method':14}{'start':7}{'mean abs. error':>20}{'RMSE of the laxity':>23}"
    lines = [f"{head}{'simulations':>13}{'seconds':>9}  ended"]
    for row in (x.to_dict() for x in rows):
        error, rmse = row["error"], row["rmse"]
        ended = ", ".join(f"{end} {n}" for end, n in row["outcomes"].items())
        lines.append(
            f"{row['method']:14}{row['start']:7}"
            f"{_short(error['kN']):>8} kN{_short(error['pct']):>7} %"
            f"{_short(rmse['mm']):>9} mm{_short(rmse['deg']):>7} deg"
            f"{row['n_simulations']:13.0f}{row['seconds']:9.2f}  {ended}"
        )
    return lines


def starts_dataset(rows: Sequence[StartRow]) -> xarray.Dataset:
    """All fits, one after the other: theta, errors, outcome, method and start of each."""
    flat = [(row, i) for row in rows for i in range(row.n_runs)]
    parameters = rows[0].fits[0].parameters
    return xarray.Dataset(
        {
            "method": ("fit", [row.method for row, _ in flat]),
            "start": ("fit", [row.start for row, _ in flat]),
            "outcome": ("fit", [row.fits[i].outcome.value for row, i in flat]),
            "seed": ("fit", [row.fits[i].seed for row, i in flat]),
            "n_simulations": ("fit", [row.fits[i].n_simulations for row, i in flat]),
            "seconds": ("fit", [row.fits[i].seconds for row, i in flat]),
            "objective": ("fit", [row.fits[i].objective for row, i in flat]),
            "theta": (("fit", "parameter"), np.array([row.fits[i].theta for row, i in flat])),
            "error_kN": ("fit", [row.error_kN[i] for row, i in flat]),
            "error_pct": ("fit", [row.error_pct[i] for row, i in flat]),
            "rmse_mm": ("fit", [row.rmse_mm[i] for row, i in flat]),
            "rmse_deg": ("fit", [row.rmse_deg[i] for row, i in flat]),
        },
        coords={"parameter": list(parameters.names)},
    )


def _short(value: float) -> str:
    """Two decimals, or an order of magnitude where these would all be zero."""
    return f"{value:.2f}" if value == 0 or value >= 0.005 else f"{value:.0e}"
