"""
A knee from MRI
===============

The knee ``lenhart2015_stable`` was segmented from the MRI of a healthy woman. Its cartilage is
real, and its insertions were moved until it is stable. Here drawer tests are simulated and
fitted again, to see what they determine.
"""

import tempfile
from pathlib import Path

import identknee as ik

# %%
# The picture shows the knee in its scanned pose, from behind and the medial side.

knee = ik.example("lenhart2015_stable")
figure = ik.scene(knee)

# %%
# Nine drawer trials with 0.3 mm and 0.3 deg of noise stand in for a measurement. With your own
# table this line is ``ik.read_laxity("data.csv")``.

data = ik.simulate(knee, "drawer", noise="0.3mm,0.3deg", seed=1).noisy

# %%
# The fit starts from the fourth initial guess of the paper, the one furthest from the truth.

answer = ik.fit(knee, data, start="IG4")
print(answer)

# %%
# The fit is good, and its anterior cruciate is wrong: 6 kN, where the data were simulated with 10
# kN. Nothing in the error says so. Which combinations of parameters do drawer tests alone
# determine?

known = ik.information(knee, data)
print(known)
figure = known.plot()

# %%
# What to keep: a page with both answers, and the table of estimates for a paper.

folder = Path(tempfile.mkdtemp())
page = ik.report([answer, known], folder / "report.html", knee=knee)
known.to_dataframe("estimates").to_csv(folder / "estimates.csv", index=False)
print(sorted(x.name for x in folder.iterdir()))

# %%
# The combinations on the right are sloppy: the data hardly determine them, above all the cruciates'
# stiffness. ``ik.design(knee, data)`` says which trials would. In a notebook
# ``ik.scene_3d(knee, answer)`` shows the fitted knee, which you can turn.
