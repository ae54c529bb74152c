"""
A knee from an OpenSim model
============================

OpenSim JAM models hold contact meshes and ligaments. The smallest possible one is written here: two
bodies, their joint, two meshes and the ligaments of the reference knee.
"""

import tempfile
from pathlib import Path

import identknee as ik
from identknee.subject.surface import joined, write_surface

folder = Path(tempfile.mkdtemp())
like = ik.reference_knee(edge_mm=2.0)

# %%
# OpenSim uses metres. Meshes lie beside the model or in its folder ``Geometry``.

(folder / "Geometry").mkdir()
write_surface(like.femur.scaled(1e-3), folder / "Geometry" / "femur.stl")
write_surface(joined(*like.tibia).scaled(1e-3), folder / "Geometry" / "tibia.stl")


def mesh(bone):
    """A contact mesh on a body."""
    return f"""<Smith2018ContactMesh name="{bone}_mesh">
    <socket_frame>/bodyset/{bone}_r</socket_frame>
    <location>0 0 0</location><orientation>0 0 0</orientation>
    <mesh_file>{bone}.stl</mesh_file><scale_factors>1 1 1</scale_factors></Smith2018ContactMesh>"""


def end(bone, point):
    """An insertion [mm] on a body, in metres."""
    place = " ".join(str(x / 1000.0) for x in point)
    return f"""<PathPoint name="{bone}">
    <socket_parent_frame>/bodyset/{bone}_r</socket_parent_frame>
    <location>{place}</location></PathPoint>"""


def line(ligament):
    """A ligament: OpenSim's slack length follows from the length in the pose of the scan."""
    slack = ligament.length / 1000.0 / (1.0 + ligament.reference_strain_pct / 100.0)
    return f"""<Blankevoort1991Ligament name="{ligament.name}"><GeometryPath><PathPointSet>
    <objects>{end("femur", ligament.femur)}{end("tibia", ligament.tibia)}</objects>
    </PathPointSet></GeometryPath><linear_stiffness>{1000.0 * ligament.stiffness_kN}
    </linear_stiffness><slack_length>{slack}</slack_length></Blankevoort1991Ligament>"""


model = folder / "small_knee.osim"
model.write_text(
    f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000"><Model name="small_knee">
<JointSet><objects><CustomJoint name="knee_r">
  <socket_parent_frame>/bodyset/femur_r</socket_parent_frame>
  <socket_child_frame>/bodyset/tibia_r</socket_child_frame>
  <SpatialTransform><TransformAxis name="rotation1"><axis>0 0 1</axis></TransformAxis>
  </SpatialTransform>
</CustomJoint></objects></JointSet>
<ForceSet><objects>{"".join(line(x) for x in like.ligaments)}</objects></ForceSet>
<ContactGeometrySet><objects>{mesh("femur")}{mesh("tibia")}</objects></ContactGeometrySet>
<length_units>m</length_units></Model></OpenSimDocument>
""",
    encoding="utf-8",
)

# %%
# The import takes the pose in which all coordinates are zero. What it had to leave out, such as
# points by which a ligament wraps around bone, is listed in the description.

knee = ik.import_opensim(model)
print(knee.side, knee.description)
for ligament in knee.ligaments:
    print(
        f"{ligament.name}: {ligament.stiffness_kN:.1f} kN, {ligament.reference_strain_pct:.1f} % "
        f"strain at {ligament.length:.1f} mm"
    )

# %%
# ``bundles="merged"`` merges many bundles into the four single lines of the literature.

figure = ik.scene(knee)

# %%
# Every verb takes a subject folder, and you can edit it by hand:

ik.write_subject(knee, folder / "subject")
print(sorted(x.name for x in (folder / "subject").iterdir()))

# %%
# On the command line: ``identknee subject import-osim small_knee.osim --out subject``. A model with
# all bundles of a real knee comes with identknee: ``ik.import_opensim("lenhart2015")``.
