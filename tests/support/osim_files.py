"""Small OpenSim models: the reference knee between a femur and a tibia that may be anywhere."""

from pathlib import Path

import numpy as np

from identknee.runs.declare import Array
from identknee.subject.knee import Knee
from identknee.subject.surface import joined, write_surface

OFFSET = """<frames><PhysicalOffsetFrame name="{name}">
<socket_parent>/bodyset/{body}</socket_parent>
<translation>{translation}</translation><orientation>{orientation}</orientation>
</PhysicalOffsetFrame></frames>"""
AXIS = """<TransformAxis name="{name}"><coordinates></coordinates><axis>{axis}</axis>{function}
</TransformAxis>"""
LINEAR = '<LinearFunction name="function"><coefficients>1 {}</coefficients></LinearFunction>'
LIGAMENT = """<Blankevoort1991Ligament name="{name}"><GeometryPath name="geometrypath">
<PathPointSet><objects>
<PathPoint name="a"><socket_parent_frame>/bodyset/femur_{side}</socket_parent_frame>
<location>{femur}</location></PathPoint>{via}
<PathPoint name="b"><socket_parent_frame>/bodyset/tibia_{side}</socket_parent_frame>
<location>{tibia}</location></PathPoint>
</objects></PathPointSet></GeometryPath>
<linear_stiffness>{stiffness}</linear_stiffness><slack_length>{slack}</slack_length>
</Blankevoort1991Ligament>"""
MESH = """<Smith2018ContactMesh name="{bone}_mesh">
<socket_frame>/bodyset/{bone}_{side}</socket_frame>
<location>0 0 0</location><orientation>0 0 0</orientation>
<mesh_file>{bone}.stl</mesh_file><scale_factors>1 1 1</scale_factors></Smith2018ContactMesh>"""


def words(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def write_model(
    folder: Path,
    knee: Knee,
    *,
    side: str = "r",
    turn: float = 0.0,
    shift: Array | None = None,
    offset: Array | None = None,
    via: str = "",
) -> Path:
    """An .osim file whose tibia is displaced by the joint (turned about x [rad], shifted [m]).

    All insertions and meshes are those of the knee in its scanned pose, in metres; a left model
    is the mirrored knee. The joint's frame on the femur is at `offset` [m].
    """
    shift = np.zeros(3) if shift is None else shift
    offset = np.zeros(3) if offset is None else offset
    mirror = np.array([1.0, 1.0, -1.0 if side == "l" else 1.0])
    shown = knee.mirrored() if side == "l" else knee
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])

    def in_tibia(point: Array) -> Array:
        placed: Array = rotation.T @ (point / 1000.0 - offset - shift)
        return placed

    ligaments = "".join(
        LIGAMENT.format(
            name=x.name,
            side=side,
            femur=words(x.femur / 1000.0 * mirror),
            tibia=words(in_tibia(x.tibia * mirror)),
            stiffness=1000.0 * x.stiffness_kN,
            slack=x.length / 1000.0 / (1.0 + x.reference_strain_pct / 100.0),
            via=via,
        )
        for x in knee.ligaments
    )
    axes = "".join(
        AXIS.format(name=name, axis=axis, function=LINEAR.format(value))
        for name, axis, value in [
            ("rotation1", "1 0 0", turn),
            ("translation1", "1 0 0", shift[0]),
            ("translation2", "0 1 0", shift[1]),
            ("translation3", "0 0 1", shift[2]),
        ]
    )
    frame = OFFSET.format(
        name="femur_offset",
        body=f"femur_{side}",
        translation=words(offset),
        orientation="0 0 0",
    )
    meshes = "".join(MESH.format(bone=x, side=side) for x in ("femur", "tibia"))
    path = folder / "small.osim"
    path.write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000"><Model name="small"><JointSet><objects>
<CustomJoint name="knee_{side}"><socket_parent_frame>femur_offset</socket_parent_frame>
<socket_child_frame>/bodyset/tibia_{side}</socket_child_frame>{frame}
<SpatialTransform>{axes}</SpatialTransform></CustomJoint>
</objects></JointSet><ForceSet><objects>{ligaments}</objects></ForceSet>
<ContactGeometrySet><objects>{meshes}</objects></ContactGeometrySet>
<length_units>m</length_units></Model></OpenSimDocument>
""",
        encoding="utf-8",
    )
    geometry = folder / "Geometry"
    geometry.mkdir(exist_ok=True)
    write_surface(shown.femur.scaled(1e-3), geometry / "femur.stl")
    tibia = joined(*shown.tibia).scaled(1e-3)
    write_surface(tibia.moved(rotation.T, -rotation.T @ (offset + shift)), geometry / "tibia.stl")
    return path
