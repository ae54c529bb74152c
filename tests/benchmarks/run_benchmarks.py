"""Measure speed and memory: ``python tests/benchmarks/run_benchmarks.py [--only ROW ...]``."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[2] / x) for x in ("tests", "tests/support", "studies")]

from requirement_rows import run

MODULES = {
    "kernel": "bench_kernel",
    "opensim": "bench_opensim",
    "trimesh_root": "bench_trimesh_root",
    "first_contact": "bench_first_contact",
    "first_answer": "bench_first_answer",
    "field": "bench_field",
    "complex_fit": "bench_complex_fit",
    "least_squares_fit": "bench_least_squares_fit",
    "memory": "bench_memory",
    "many_trials": "bench_many_trials",
    "fine_surfaces": "bench_fine_surfaces",
    "process_pool": "bench_process_pool",
    "sweep": "bench_sweep",
    "sampling": "bench_sampling",
    "posterior": "bench_posterior",
    "uncertain_posterior": "bench_uncertain_posterior",
    "diagnosis": "bench_diagnosis",
    "many_parameters": "bench_many_parameters",
    "time_left": "bench_time_left",
}

if __name__ == "__main__":
    raise SystemExit(run("benchmarks", MODULES, "tests/benchmarks/run_benchmarks.py"))
