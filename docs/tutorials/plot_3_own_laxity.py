"""
Your own laxity data
====================

A laxity table is a CSV file with one row per trial: the loads that were applied and where the tibia
went. Here one is simulated with the reference knee and the noise of a test rig.
"""

import tempfile
from pathlib import Path

import numpy as np

import identknee as ik
from identknee.report.parameter_figures import profiles_figure

folder = Path(tempfile.mkdtemp())
knee = ik.reference_knee()
truth = ik.simulate(knee, ik.load_protocol("seed63"), {"ACL.stiffness_kN": 9.5})
measured = ik.add_noise(truth.laxity, sd_mm=0.3, sd_deg=0.3, seed=1)
path = ik.write_laxity(measured, folder / "laxity.csv")

# %%
# A table that a robot measured on a cadaver comes with identknee: ``ik.example_laxity("s192803")``.
#
# This is what the file looks like. A missing load column means a load of zero, a blank cell was not
# measured, and the columns ``sd_`` state the errors.

for row in path.read_text(encoding="utf-8").splitlines()[:4]:
    print(row[:96])

# %%
# Reading checks the table. A mistake is reported with its row, its column and a remedy.

wrong = path.read_text(encoding="utf-8").replace("0.0,", "O.0,", 1)
(folder / "wrong.csv").write_text(wrong, encoding="utf-8")
try:
    ik.read_laxity(folder / "wrong.csv")
except ik.InputError as error:
    print(str(error).replace(str(folder), "."))

# %%
# A model of the knee under the trials of the data, and the difference between model and data,
# weighted by the stated errors:

laxity = ik.read_laxity(path)
model = ik.LaxityModel(knee=knee, protocol=laxity.protocol)
problem = ik.LaxityResiduals(model=model, laxity=laxity, weighting="noise")

# %%
# The fit begins far from the truth, at the worst of the paper's four initial guesses.

found = ik.fit(knee, laxity, start="IG4", weighting="noise")
print(found)

# %%
# Is the misfit no larger than noise? If so, the mean square is about one with these weights.

residuals = problem.residuals(found.theta)
print(f"mean square of the residuals: {np.mean(residuals**2):.2f}")
error = ik.laxity_rmse(model.simulate(found.theta), laxity)
print(f"root mean square: {error.mm:.2f} mm, {error.deg:.2f} deg")

# %%
# A fit is not yet an answer. Within what limits do these data determine the cruciates?

names = ["ACL.stiffness_kN", "ACL.reference_strain_pct", "PCL.stiffness_kN"]
profiles = ik.profile_parameters(problem, found.theta, names)
for profile in profiles:
    lower, upper = (
        "open" if end is None else f"{end:.2f}" for end in (profile.lower, profile.upper)
    )
    print(f"{profile.name}: {lower} to {upper} {profile.unit}, {profile.verdict.value}")
figure = profiles_figure(profiles)

# %%
# What to keep: the figure, its text still text, and the numbers for a table.

figure.savefig(folder / "profiles.svg")
(folder / "intervals.csv").write_text(
    "\n".join(["parameter,lower,upper", *(f"{x.name},{x.lower},{x.upper}" for x in profiles)]),
    encoding="utf-8",
)

# %%
# The true stiffness of the anterior cruciate was 9.5 kN. On the command line: ``identknee fit
# SUBJECT laxity.csv --start IG4 --weighting noise``, then ``identknee profile SUBJECT laxity.csv``.
