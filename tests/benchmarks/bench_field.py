"""Time to build the distance field of a real femur, with and without compiling, and to read it."""

import argparse
import tempfile
from pathlib import Path

from fresh_process import run_fresh
from requirement_rows import Row, median_of

REPEATS = 3
BUILD = """
import json, time
from knees import knee
from identknee.mechanics.closest_point import mesh_distance
from identknee.mechanics.distance_field import build_field
from identknee.model import contact_geometry as joint
subject = knee("lenhart2015")
vertices = subject.femur_frame.to_local(subject.femur.vertices)

def build():
    distance = mesh_distance(vertices, subject.femur.faces)
    return build_field(distance, vertices.min(axis=0), vertices.max(axis=0))

def seconds(work):
    began = time.perf_counter()
    field = work()
    return time.perf_counter() - began, field

first, field = seconds(lambda: joint._field(subject, vertices))
again, _ = seconds(build)
cached, same = seconds(lambda: joint._field(subject, vertices))
print(json.dumps({
    "first": first, "again": again, "cached": cached, "nodes": field.coefficients.size,
    "vertices": len(vertices), "equal": bool((same.coefficients == field.coefficients).all()),
}))
"""


def measure(options: argparse.Namespace) -> Row:
    """Each repeat in a process of its own with an empty cache."""
    found = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as cache:
            found.append(run_fresh(BUILD, Path(cache))[0])
    if not all(x["equal"] for x in found):
        raise AssertionError
    return Row(
        line="signed-distance field of lenhart2015 full femur <= 10 s, then from cache",
        measures=[
            median_of("from scratch, compiling", [x["first"] for x in found], "s", bar=10.0),
            median_of("from scratch, compiled", [x["again"] for x in found], "s"),
            median_of("from the cache", [x["cached"] for x in found], "s"),
        ],
        notes=[f"{found[0]['vertices']:,} vertices, {found[0]['nodes']:,} nodes of the grid"],
    )
