"""Rows of laxity tables that are gross errors: how many are found, how many sound ones accused."""

import argparse
from dataclasses import replace

import numpy as np
from planted_conventions import NOISE, clean_table
from rows import Measure, Row
from scipy.stats import beta

from identknee.calibrate.fit import fit
from identknee.checks.contradicted_trials import contradicted_rows, suspicious_end_points
from identknee.laxity.protocol import opposite_pairs
from identknee.laxity.table import Laxity, example_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals

KNEES = ("reference", "lenhart2015_stable")
N = 100  # tables of each knee, once clean and once with a gross row
GROSS = 10.0 * NOISE


def measure(options: argparse.Namespace) -> Row:
    """Shares of gross rows found and of clean tables accused, and the measured specimen's rows."""
    found, alone, accused = 0, 0, 0
    for name in KNEES:
        for seed in range(1000, 1000 + N):
            model, laxity = clean_table(name, seed)
            accused += bool(_rows(model, laxity))
            wrong, trial = _with_gross_row(laxity, seed)
            rows = _rows(model, wrong)
            found += trial in rows
            alone += rows == [trial]
    total = len(KNEES) * N
    specimen = example_laxity("s192803")
    flagged = [specimen.protocol.trials[x.trial] for x in suspicious_end_points(specimen)]
    return Row(
        line="200 simulated tables with one gross row: found >= 95 %, false flags <= 5 % of clean "
        "tables; of s192803 Valgus_60 and no other",
        measures=[
            _share("gross rows found", found, total, bar=95.0, at_least=True),
            _share("tables in which they alone are flagged", alone, total),
            _share("clean tables accused", accused, total, bar=5.0),
            Measure(
                what="s192803, rows flagged that are not Valgus_60, or Valgus_60 missed",
                value=len({*flagged} ^ {"Valgus_60"}),
                unit="",
                bar=0,
                count=specimen.n,
            ),
        ],
        notes=[
            f"69 trials, noise {NOISE:g} mm and deg",
            f"gross is one value off by {GROSS:g} mm or deg or the pose of the opposite load",
            "s192803 by the course of its end points over flexion, no model fitted",
        ],
    )


def _rows(model: LaxityModel, laxity: Laxity) -> list[int]:
    own = model.parameters.start
    end = fit(LaxityResiduals(model=model, laxity=laxity), own, method="least-squares")
    return [x.trial for x in contradicted_rows(model, laxity, end.theta)]


def _with_gross_row(laxity: Laxity, seed: int) -> tuple[Laxity, int]:
    """The table with one row spoilt, and which."""
    generator, coordinates = np.random.default_rng(seed), np.array(laxity.coordinates)
    if seed % 2:
        pairs = opposite_pairs(laxity.protocol)
        apart = np.abs(np.diff(coordinates[pairs], axis=1)[:, 0]).max(axis=1) >= GROSS
        trial, other = generator.permuted(generator.choice(pairs[apart])).tolist()
        coordinates[trial] = laxity.coordinates[other]
    else:
        trial = int(generator.integers(laxity.n))
        coordinates[trial, generator.integers(5)] += GROSS * generator.choice([-1.0, 1.0])
    return replace(laxity, coordinates=coordinates), trial


def _share(
    what: str, count: int, total: int, *, bar: float | None = None, at_least: bool = False
) -> Measure:
    low = beta.ppf(0.025, count, total - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, total - count) if count < total else 1.0
    return Measure(
        what=what,
        value=100.0 * count / total,
        unit="%",
        bar=bar,
        at_least=at_least,
        low=100.0 * float(low),
        high=100.0 * float(high),
        count=total,
        interval="95 % Clopper-Pearson",
    )
