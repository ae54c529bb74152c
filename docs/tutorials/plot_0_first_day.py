"""
A first day with your own knee
==============================

From files to an answer, in the order in which you will need them: cartilage surfaces, a table from
the robot, a fit, a check of that fit, and the way back to OpenSim. The files of the analytic knee
``reference`` stand in for yours. Download this page as a notebook at its end and put yours in.
"""

# sphinx_gallery_thumbnail_number = 2
import tempfile
from pathlib import Path

import identknee as ik
from identknee.subject.surface import write_surface

folder = Path(tempfile.mkdtemp())
like = ik.reference_knee(edge_mm=1.6)

# %%
# Morning: the knee
# -----------------
# Three STL files, in mm, in the pose in which the knee was scanned. Yours come from segmentation.

knee_folder = folder / "S07"
knee_folder.mkdir()
write_surface(like.femur, knee_folder / "femur.stl")
write_surface(like.tibia[0], knee_folder / "tibia_medial.stl")
write_surface(like.tibia[1], knee_folder / "tibia_lateral.stl")

# %%
# ``subject.toml`` says which is which, where the bones' axes are, and where the ligaments insert.
# With landmarks in place of frames identknee makes the axes itself.

ligaments = "".join(
    f"""
[[ligaments]]
name = "{x.name}"
femur = {x.femur.tolist()}
tibia = {x.tibia.tolist()}
stiffness_kN = {x.stiffness_kN}
reference_strain_pct = {x.reference_strain_pct}
"""
    for x in like.ligaments
)
frames = "".join(
    f"""
[frames.{bone}]
origin = {frame.origin.tolist()}
axes = {frame.axes.tolist()}
"""
    for bone, frame in (("femur", like.femur_frame), ("tibia", like.tibia_frame))
)
(knee_folder / "subject.toml").write_text(
    f"""
format = 1
name = "S07"
side = "right"

[surfaces]
femur = "femur.stl"
tibia_medial = "tibia_medial.stl"
tibia_lateral = "tibia_lateral.stl"
{frames}{ligaments}""",
    encoding="utf-8",
)
knee = ik.read_subject(knee_folder)

# %%
# Look at it before anything else. A wrong axis or an insertion on the wrong bone shows at once, and
# the check names what does not look like a knee. ``identknee subject check S07`` also tries every
# trial.

figure = ik.scene(knee)
for finding in ik.check_geometry(knee):
    print(finding.line)

# %%
# Noon: the robot's table
# -----------------------
# One row per trial: the loads, and where the tibia went. A load that has no column was zero. This
# table is simulated with a stiffer anterior cruciate than the subject file states. Your own table
# has rows like these.

truth = ik.simulate(knee, "drawer", {"ACL.stiffness_kN": 12.0})
table = ik.write_laxity(
    ik.add_noise(truth.laxity, sd_mm=0.2, sd_deg=0.2, seed=7), folder / "robot.csv"
)
for row in table.read_text(encoding="utf-8").splitlines()[:3]:
    print(row[:96])

# %%
# Reading it is a check too: a mistake is named with its row, its column and what to do.

data = ik.read_laxity(table)

# %%
# Afternoon: the fit, and how far to trust it
# -------------------------------------------

answer = ik.fit(knee, data, weighting="noise", out=folder / "results" / "fit")
print(answer)

# %%
# The fit is good. That says little about the parameters: which of them do nine drawer trials
# determine?

profiles = ik.profile(
    knee,
    data,
    parameters=["ACL.stiffness_kN", "MCL.stiffness_kN"],
    out=folder / "results" / "profile",
)
print(profiles)
figure = profiles.plot()

# %%
# The truth, 12 kN for the anterior cruciate, should lie in its set. That set is the answer to write
# into a paper. The width of the set says whether more trials are needed; ``ik.design(knee, data)``
# names them.
#
# Evening: for others
# -------------------
# One page for the co-authors, with the knee to turn:

page = ik.report(folder / "results", folder / "results" / "report.html", knee=knee)
print(page.name, f"{page.stat().st_size / 1e6:.1f} MB")

# %%
# The fitted knee for OpenSim, ParaView and PEtab. If yours came from an ``.osim`` file by
# ``ik.import_opensim("model.osim")``, give that file as ``source``: everything else in it stays.

written = ik.report.export_subject(
    knee, fitted=folder / "results", osim=True, out=folder / "S07-fitted"
)
print([Path(x).name for x in written.written])
again = ik.import_opensim(folder / "S07-fitted" / "S07.osim")
print(f"{again.ligament('ACL').stiffness_kN:.2f} kN in the model for OpenSim")

# %%
# On the command line the day is::
#
#     identknee subject check S07
#     identknee fit S07 robot.csv --weighting noise --out results/fit
#     identknee profile S07 robot.csv --out results/profile
#     identknee report results
#     identknee subject export S07 --fitted results --osim --out S07-fitted
#
# Next: each step in full, for :doc:`surfaces and landmarks </gallery/plot_1_own_knee>`,
# :doc:`OpenSim models </gallery/plot_2_opensim>`, :doc:`laxity tables
# </gallery/plot_3_own_laxity>` and :doc:`the other questions </gallery/plot_4_which_verb>`.
