"""
Which verb answers which question
=================================

One data set, and every question that can be asked of a calibration. The answers here are kept
small; the command for the full answer is given with each.
"""

# sphinx_gallery_thumbnail_number = 2
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.identify.equivalents import equivalents
from identknee.identify.information import information as fisher_information
from identknee.report.parameter_figures import intervals_figure, ranges_figure, spectrum_figure
from identknee.report.sweep_figures import waterfall_figure

knee = ik.reference_knee()
truth = ik.simulate(knee, ik.load_protocol("seed63"))
laxity = ik.add_noise(truth.laxity, sd_mm=0.5, sd_deg=0.5, seed=2)
model = ik.LaxityModel(knee=knee, protocol=laxity.protocol)
problem = ik.LaxityResiduals(model=model, laxity=laxity, weighting="noise")
best = fit(problem, problem.parameters.center)

# %%
# Do all starts lead to the same parameters?
# -------------------------------------------
# ``identknee sweep``: searches from everywhere, and what stopped each of them. A failed start
# counts too: with these parameters the knee has no equilibrium in some trial.

searches = ik.sweep(knee, laxity, n_starts=24, paths=0).searches
for kind in (ik.Outcome.MINIMUM, ik.Outcome.VALLEY, ik.Outcome.CLIFF, ik.Outcome.START_FAILED):
    print(f"{searches.is_kind(kind).sum():3} {kind.value:12} {kind.sentence}")
number = np.arange(1, searches.n + 1)
ends = {"end": (number, np.sort(searches.objectives))}
figure = waterfall_figure({"Least squares from 24 starts": ends})

# %%
# Which combinations are stiff, which sloppy?
# -------------------------------------------
# ``identknee information``: eigenvalues of the Fisher information above the solver's own noise.

information = fisher_information(problem, best.theta)
print("best known: ", information.combination(0))
print("least known:", information.combination(len(information.eigenvalues) - 1))
figure = spectrum_figure({"reference": information})

# %%
# Which values do the data allow?
# -------------------------------
# ``identknee profile``: sets that end only where the data limit them.

names = ["ACL.stiffness_kN", "PCL.stiffness_kN", "MCL.stiffness_kN"]
profiles = ik.profile_parameters(problem, best.theta, names)
figure = intervals_figure(profiles)

# %%
# How different may two knees be that these data cannot tell apart?
# -----------------------------------------------------------------
# ``identknee equivalents``: parameter sets as different as possible, whose predictions differ by
# less than one squared standard deviation in total.

region = ik.identify.noise_region(problem, best.theta)
found = equivalents(region, n_sets=6, seed=0)
names = problem.parameters.names
stiffness = [i for i, name in enumerate(names) if name.endswith("_kN")]
spread = np.array([[found.sets[:, i].min(), found.sets[:, i].max()] for i in stiffness])
figure = ranges_figure(
    [names[i] for i in stiffness], best.theta[stiffness], {"6 sets": spread}, unit="kN"
)

# %%
# What to keep: the sets themselves, each a knee that these data cannot tell from yours.

table = pd.DataFrame(found.sets, columns=names)
table.to_csv(Path(tempfile.mkdtemp()) / "sets.csv", index=False)
print(table.round(2))

# %%
# Where to go from here
# ---------------------
# ================================================= ============================
# question                                          command
# ================================================= ============================
# How probable is each value?                       ``identknee sample``
# Which parameter moves which laxity?               ``identknee sensitivity``
# Which trials would close the gap?                 ``identknee design``
# What does the model get wrong?                    ``identknee diagnose``
# ================================================= ============================
