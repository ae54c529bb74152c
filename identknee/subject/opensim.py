"""Knees of OpenSim models that describe contact and ligaments as OpenSim JAM does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from identknee.runs.errors import InputError
from identknee.runs.files import PathLike
from identknee.subject.check import unusable
from identknee.subject.examples import opensim_file
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee, Landmark
from identknee.subject.ligament_group import groups_by_name
from identknee.subject.opensim_bones import Bones, bones_of, contact_meshes
from identknee.subject.opensim_lines import lines_of, merged
from identknee.subject.opensim_model import MM_PER_M, Element, OsimModel, Transform
from identknee.subject.surface import Surface, joined, read_surface

# Parts of a tibial mesh smaller than this share of it are crumbs.
CRUMB_SHARE = 0.01


def import_opensim(path: PathLike, *, bundles: Literal["separate", "merged"] = "separate") -> Knee:
    """The knee of an OpenSim 4 model, all joint coordinates being zero.

    The femur is the body named so that carries a contact mesh, the tibia likewise; one joint
    connects them, perhaps with welds in between. Its two frames become the frames of the bones, in
    mm. Every ``Blankevoort1991Ligament`` from one to the other becomes a straight line, its
    reference strain following from its slack length; which of them wrapped or had further points
    is told in the description. Contact meshes are looked for beside the file and in ``Geometry``.

    Parameters
    ----------
    path
        The ``.osim`` file, or the name ``"lenhart2015"`` for the one that comes with identknee.
    bundles
        ``"separate"`` for the ligaments as they are, those tied that are called alike but for a
        number at the end; ``"merged"`` for ACL, PCL, LCL and (superficial) MCL alone, each the
        mean of its bundles' insertions, the sum of their stiffnesses and the mean of their strains
        weighted by stiffness.

    Raises
    ------
    InputError
        If a file cannot be read, holds no such knee or more than one, or uses something that is not
        supported.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    if bundles not in ("separate", "merged"):
        raise ValueError(f'bundles must be "separate" or "merged", got {bundles!r}')
    model = OsimModel(opensim_file(path))
    bones = bones_of(model)
    meshes = contact_meshes(model)
    lines, remarks = lines_of(bones)
    ligaments = [x.ligament for x in lines]
    if bundles == "merged":
        ligaments = merged(model, ligaments)
    knee = Knee(
        name=model.path.stem,
        side=bones.side,
        description=" ".join([f"Imported from {model.path.name}.", *remarks]),
        femur=joined(*_meshes(model, meshes, bones.femur)),
        tibia=_plateaus(bones, joined(*_meshes(model, meshes, bones.tibia))),
        ligaments=tuple(ligaments),
        groups=groups_by_name(ligaments) if bundles == "separate" else (),
        femur_frame=Frame(origin=np.zeros(3), axes=np.eye(3)),
        tibia_frame=Frame(
            origin=bones.tibia_frame.translation * MM_PER_M, axes=bones.tibia_frame.rotation.T
        ),
        landmarks=_landmarks(bones),
    )
    if knee.side == "left":
        knee = knee.mirrored()
    for finding in unusable(knee):
        raise InputError(model.path, finding.where, finding.sentence, finding.remedy)
    return knee


def _meshes(
    model: OsimModel, meshes: Sequence[Element], bodies: dict[str, Transform]
) -> list[Surface]:
    """The contact meshes of some bodies in the common frame [mm]."""
    surfaces = []
    for mesh in meshes:
        body, frame = model.placed(mesh.findtext("socket_frame", ""))
        if body not in bodies:
            continue
        for tag in ("location", "orientation"):
            if model.vector(mesh, tag, "0 0 0").any():
                raise model.refusal(
                    f"contact mesh {mesh.get('name')}",
                    f"its {tag} is not zero",
                    "Move the mesh in its file instead.",
                )
        name = (mesh.findtext("mesh_file") or mesh.findtext("filename") or "").strip()
        surface = read_surface(mesh_file(model, mesh, name))
        factors = model.vector(mesh, "scale_factors", "1 1 1")
        scaled = Surface(vertices=surface.vertices * factors, faces=surface.faces)
        surfaces.append((bodies[body] @ frame).moved(scaled).scaled(MM_PER_M))
    return surfaces


def mesh_file(model: OsimModel, mesh: Element, name: str) -> Path:
    """The file of a mesh, beside the model or in its folder ``Geometry``.

    Raises
    ------
    InputError
        If it is in neither.
    """
    folder = model.path.parent
    for candidate in (folder / name, folder / "Geometry" / Path(name).name):
        if name and candidate.is_file():
            return candidate
    raise model.refusal(
        f"contact mesh {mesh.get('name')}",
        f"its file {name or '(no name)'} is neither beside the model nor in Geometry",
        "Copy the mesh there.",
    )


def _plateaus(bones: Bones, tibia: Surface) -> tuple[Surface, Surface]:
    """The medial and the lateral part of a tibial surface of two unconnected parts."""
    parts = sorted(_components(tibia), key=lambda x: x.areas.sum(), reverse=True)
    parts = [x for x in parts if x.areas.sum() > CRUMB_SHARE * tibia.areas.sum()]
    if len(parts) != 2:
        raise bones.model.refusal(
            "contact geometry",
            f"the tibial mesh has {len(parts)} unconnected parts, not a medial and a lateral one",
            "Cut the mesh between the plateaus and remove everything else.",
        )
    to_right = bones.tibia_frame.rotation[:, 2]
    left, right = sorted(parts, key=lambda x: float(x.centroid @ to_right))
    return (left, right) if bones.side == "right" else (right, left)


def _components(surface: Surface) -> list[Surface]:
    n = len(surface.vertices)
    ends = surface.edges
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    number, label = connected_components(graph, directed=False)
    parts = []
    for part in range(number):
        chosen = label == part
        faces = surface.faces[chosen[surface.faces[:, 0]]]
        if len(faces):
            renumbered = (np.cumsum(chosen) - 1)[faces]
            parts.append(Surface(vertices=surface.vertices[chosen], faces=renumbered))
    return parts


def _landmarks(bones: Bones) -> tuple[Landmark, ...]:
    """The hip and the ankle centre where joints named so hold on to the bones."""
    found = {}
    for joint in bones.model.joints:
        if "hip" in joint.name.lower() and joint.child in bones.femur:
            place = bones.femur[joint.child] @ joint.child_frame
            found["hip_centre"] = place.translation
        elif "ankle" in joint.name.lower() and joint.parent in bones.tibia:
            place = bones.tibia[joint.parent] @ joint.parent_frame
            found["ankle_centre"] = place.translation
    return tuple(Landmark(name=x, position=y * MM_PER_M) for x, y in found.items())
