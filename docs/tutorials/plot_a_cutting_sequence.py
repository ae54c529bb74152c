"""
A cutting sequence
==================

Laxity of an intact knee leaves much open: very different ligaments reproduce it. A laboratory then
cuts a ligament and tests again. This page shows what the second table is worth, and what a measured
force is worth in its place. The knee is simulated, so that the truth is known.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import identknee as ik

knee = ik.reference_knee()
protocol = ik.load_protocol("table2")

# %%
# Two tables of the same knee: intact, and without its medial collateral ligament. In a file the
# column ``state`` says what was cut, and so does a protocol.


def measured(name: str, state: str, seed: int) -> ik.Laxity:
    """Simulated laxity of the knee in a state, with noise of 0.5 mm and 0.5 deg."""
    trials = replace(protocol, name=name, state=(state,) * protocol.n)
    model = ik.LaxityModel(knee=knee, protocol=trials)
    return ik.add_noise(model.simulate(model.parameters.start), sd_mm=0.5, sd_deg=0.5, seed=seed)


intact, again = measured("intact", "intact", 1), measured("again", "intact", 2)
cut = measured("mcl_cut", "cut: MCL", 3)

# %%
# A load cell gives the tension of the anterior cruciate ligament to 5 N in every trial.

model = ik.LaxityModel(knee=knee, protocol=protocol)
tension = ik.model.tensions_of(model, model.predict(model.parameters.start))[:, [0]]
errors = np.random.default_rng(4).normal(scale=5.0, size=tension.shape)
forces = ik.laxity.MeasuredForces(
    names=("ACL.tension_N",),
    values=np.maximum(tension + errors, 0.0),
    sd=np.full(tension.shape, 5.0),
)

# %%
# Each set of data has as many trials as the next, but for the one with forces, which has half.

data = {
    "intact, twice": [intact, again],
    "intact, MCL cut": [intact, cut],
    "intact, ACL force": replace(intact, forces=forces),
}
stiffness = [f"{x.name}.stiffness_kN" for x in knee.ligaments]
widths = {}
for name, tables in data.items():
    profiles = ik.profile(knee, tables, parameters=stiffness).parameters
    widths[name] = {
        parameter: x.upper - x.lower if x.lower is not None and x.upper is not None else np.nan
        for parameter, x in profiles.items()
    }
    shown = ", ".join(f"{k.partition('.')[0]} {x:.1f}" for k, x in widths[name].items())
    print(f"{name}: width of the 95 % interval [kN]: {shown}")

# %%
# A cut is no free gift. Without the medial collateral ligament the others carry its load and are
# known a little better, but half of the trials say nothing of the ligament that is gone. A force
# in half as many trials pins the tension of its ligament, not its stiffness. Which data pay depends
# on the knee: simulate first, since a cut is final. A missing bar is an open interval.

figure, axes = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
places, height = np.arange(len(knee.ligaments)), 0.25
for k, (name, own) in enumerate(widths.items()):
    axes.barh(places + (k - 1) * height, [*own.values()], height, label=name)
axes.set_yticks(places, [x.name for x in knee.ligaments])
axes.invert_yaxis()
axes.set_xlabel("width of the 95 % interval of the stiffness [kN]")
axes.legend()

# %%
# What to keep: the figure, and its numbers.

folder = Path(tempfile.mkdtemp())
figure.savefig(folder / "what_a_cut_is_worth.svg")
pd.DataFrame(widths).to_csv(folder / "widths.csv")
print(pd.DataFrame(widths).round(1))

# %%
# On the command line the same is ``identknee profile SUBJECT intact.csv mcl_cut.csv``. Rigs,
# mountings and what a table with forces looks like: :doc:`/experiments`.
