"""
Your own knee from STL files
============================

A subject is a folder with three surfaces and a text file, which says where the surfaces are and
which ligaments join them. Here the files of the analytic knee ``reference`` stand in for yours.
"""

# sphinx_gallery_thumbnail_number = 2
import tempfile
from pathlib import Path

import pandas as pd

import identknee as ik
from identknee.subject.surface import write_surface

# %%
# The surfaces are open sheets of cartilage in the pose in which the knee was scanned, in mm, with
# x anterior, y superior and z to the subject's right.

folder = Path(tempfile.mkdtemp())
like = ik.reference_knee(edge_mm=1.6)
write_surface(like.femur, folder / "femur.stl")
write_surface(like.tibia[0], folder / "tibia_medial.stl")
write_surface(like.tibia[1], folder / "tibia_lateral.stl")

# %%
# ``subject.toml`` names them. The axes of the bones come from landmarks, or are given as frames as
# here. A ligament has two insertions, a stiffness and the strain it has in the scanned pose.

ACL, PCL, LCL, MCL = like.ligaments
text = f"""
format = 1
name = "mine"
side = "right"

[surfaces]
femur = "femur.stl"
tibia_medial = "tibia_medial.stl"
tibia_lateral = "tibia_lateral.stl"

[frames.femur]
origin = {like.femur_frame.origin.tolist()}
axes = {like.femur_frame.axes.tolist()}

[frames.tibia]
origin = {like.tibia_frame.origin.tolist()}
axes = {like.tibia_frame.axes.tolist()}
"""
for ligament in (ACL, PCL, LCL, MCL):
    text += f"""
[[ligaments]]
name = "{ligament.name}"
femur = {ligament.femur.tolist()}
tibia = {ligament.tibia.tolist()}
stiffness_kN = {ligament.stiffness_kN}
reference_strain_pct = {ligament.reference_strain_pct}
"""
(folder / "subject.toml").write_text(text, encoding="utf-8")
knee = ik.read_subject(folder)

# %%
# Files that can be read may still be wrong. ``identknee subject check`` checks surfaces, frames and
# ligaments. So does this call, with a remedy for each finding.

for finding in ik.check_geometry(knee):
    print(finding.line)

# %%
# Look at the knee from behind and from the side: a misplaced insertion shows at once.

figure = ik.scene(knee)

# %%
# How lax is it? Each trial follows its load from the unloaded knee, and says how it ended.

simulation = ik.simulate(knee, "drawer")
drawer = simulation.laxity.coordinates[:, 1]
for trial, value in zip(simulation.trials, drawer, strict=True):
    print(f"{trial.trial:24} {trial.outcome.value:10} anterior drawer {value:6.2f} mm")
figure = simulation.plot()

# %%
# The stability margin says how far each pose is from a jump. Calibrate a knee only if the margin is
# good over the whole protocol.

print(f"smallest margin: {min(x.margin_N_per_mm for x in simulation.trials):.1f} N/mm")

# %%
# In a notebook the meshes and insertions are often there already. The same keys as in
# ``subject.toml`` then make a knee without a file: a surface is anything with ``vertices`` and
# ``faces``, such as a mesh of trimesh, or a pair of such arrays; ligaments are a data frame.

insertions = pd.DataFrame(
    {
        "name": x.name,
        **dict(zip(("femur_x_mm", "femur_y_mm", "femur_z_mm"), x.femur, strict=True)),
        **dict(zip(("tibia_x_mm", "tibia_y_mm", "tibia_z_mm"), x.tibia, strict=True)),
        "stiffness_kN": x.stiffness_kN,
        "reference_strain_pct": x.reference_strain_pct,
    }
    for x in like.ligaments
)
frames = {"femur": like.femur_frame, "tibia": like.tibia_frame}
in_memory = ik.read_subject(
    {
        "name": "mine",
        "side": "right",
        "surfaces": {
            "femur": like.femur,
            "tibia_medial": like.tibia[0],
            "tibia_lateral": (like.tibia[1].vertices, like.tibia[1].faces),
        },
        "frames": {bone: {"origin": x.origin, "axes": x.axes} for bone, x in frames.items()},
        "ligaments": insertions,
    }
)
print(in_memory.name, [x.name for x in in_memory.ligaments])

# %%
# What to keep: the folder of the knee, and a page with the simulation to send to a colleague.

ik.write_subject(in_memory, folder / "kept")
page = ik.report(simulation, folder / "report.html", knee=knee)
print(page.name, sorted(x.name for x in (folder / "kept").iterdir()))

# %%
# The same on the command line: ``identknee subject check FOLDER``, ``identknee subject show
# FOLDER``, ``identknee simulate FOLDER --protocol drawer``.
