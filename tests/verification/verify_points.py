"""How much the choice of contact points moves the poses of a real knee."""

import argparse

import numpy as np
from knees import model
from requirement_rows import Measure, Row

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS

BAR_MM, BAR_DEG = 0.07, 0.25


def measure(options: argparse.Namespace) -> Row:
    """Largest change over the 63 trials between the default points and all vertices."""
    few, all_of_them = model("lenhart2015_stable"), model("lenhart2015_stable", None)
    theta = few.parameters.center
    first, second = (x.predict(theta, derivatives=False) for x in (few, all_of_them))
    change = np.abs(first.coordinates - second.coordinates)
    measures = []
    for unit, columns, bar in (("mm", TRANSLATIONS, BAR_MM), ("deg", ROTATIONS, BAR_DEG)):
        part = change[:, columns].max(axis=1)
        measures.append(
            Measure(
                what="lenhart2015_stable, largest",
                value=float(part.max()),
                unit=unit,
                bar=bar,
                low=float(np.median(part)),
                high=float(part.max()),
                count=len(part),
                interval="median and largest of the trials",
            )
        )
    by_coordinate = ", ".join(
        f"{name} {value:.3f}" for name, value in zip(COORDINATES, change.max(axis=0), strict=True)
    )
    n = [len(x.joint.contact.points) for x in (few, all_of_them)]
    return Row(
        line="default contact points against all vertices over seed63: <= 0.07 mm, <= 0.25 deg",
        measures=measures,
        notes=[f"{n[0]:,} points against {n[1]:,}; {by_coordinate}"],
    )
