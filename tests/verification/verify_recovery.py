"""Recovery of a knee's own parameters by least squares from its noise-free laxity."""

import argparse

from knees import model, noise_free
from requirement_rows import Measure, Row

from identknee.calibrate.fit import fit, named_start

BAR = 1e-6


def measure(options: argparse.Namespace) -> Row:
    """Largest error of a stiffness and of a reference strain after each fit."""
    measures, notes = [], []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        problem = noise_free(subject)
        m = subject.parameters.n // 2
        for start in ("IG1", "IG2", "IG3", "IG4"):
            end = fit(problem, named_start(start, subject.parameters), method="least-squares")
            error = abs(end.theta - subject.parameters.center)
            for unit, part in (("kN", error[:m]), ("%", error[m:])):
                value = float(part.max())
                measures.append(
                    Measure(what=f"{name}, {start}, largest", value=value, unit=unit, bar=BAR)
                )
            notes.append(f"{name}, {start}: {end.outcome.value}, {end.n_simulations} simulations")
    return Row(
        line="noise-free recovery, least squares, IG1-IG4, reference and lenhart2015_stable: "
        "<= 1e-6 kN, <= 1e-6 %",
        measures=measures,
        notes=notes,
    )
