"""
Scaling out with dask
=====================

Verbs that do many things take an executor: anything with a ``map`` that keeps order. Serial, a
pool of processes and a dask cluster give the same numbers bit for bit, as each task carries its own
seed and shares nothing.
"""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from distributed import LocalCluster

import identknee as ik
from identknee.identify.sweep import sweep
from identknee.report.sweep_figures import waterfall_figure
from identknee.runs.executors import dask_cluster

knee = ik.reference_knee()
laxity = ik.simulate(knee, ik.load_protocol("drawer")).laxity
model = ik.LaxityModel(knee=knee, protocol=laxity.protocol)
problem = ik.LaxityResiduals(model=model, laxity=laxity)
starts = ik.identify.sobol_starts(problem.parameters, 16)

# %%
# On one core, as a reference:

serial = sweep(problem, starts)

# %%
# ``dask_cluster`` takes the address of a scheduler, wherever its workers are. Here it is a cluster
# inside this process, which costs nothing. ``dask_cluster(8)`` would start eight workers, and
# ``dask_cluster("tcp://10.0.0.5:8786")`` would use those of a scheduler that is already running.

with (
    LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as it,
    dask_cluster(it.scheduler_address) as executor,
):
    scaled_out = sweep(problem, starts, executor=executor)

# %%
# The same, bit for bit:

print(np.array_equal(serial.ends, scaled_out.ends, equal_nan=True))
print(np.array_equal(serial.objectives, scaled_out.objectives, equal_nan=True))
number = np.arange(1, scaled_out.n + 1)
ends = {"end": (number, np.sort(scaled_out.objectives))}
figure = waterfall_figure({"Least squares from 16 starts": ends})

# %%
# What to keep: where every search ended, a row a start.

table = pd.DataFrame(scaled_out.ends, columns=problem.parameters.names)
table["objective"] = scaled_out.objectives
table.to_csv(Path(tempfile.mkdtemp()) / "ends.csv", index=False)
print(table.round(2).head(3))

# %%
# On the command line ``--workers N`` starts N processes; ``--workers tcp://10.0.0.5:8786`` works on
# the cluster of that scheduler. So does the argument ``workers`` of a verb in Python. If a worker
# is lost, its tasks go to another. A run that was stopped resumes when the same command is given
# again, with any workers.
