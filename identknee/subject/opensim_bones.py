"""The bones of a knee in an OpenSim model: which bodies they are, and where."""

import re
from dataclasses import dataclass

from identknee.subject.knee import Side
from identknee.subject.opensim_model import Element, Joint, OsimModel, Transform

MESH_CLASSES = ("Smith2018ContactMesh", "ContactMesh")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bones:
    """The joint of a knee, and where its bodies are in the joint's parent frame [m]."""

    model: OsimModel
    joint: Joint
    side: Side
    femur: dict[str, Transform]
    tibia: dict[str, Transform]
    tibia_frame: Transform


def contact_meshes(model: OsimModel) -> list[Element]:
    """The contact meshes of a model."""
    return [x for kind in MESH_CLASSES for x in model.all_of(kind)]


def bones_of(model: OsimModel) -> Bones:
    """The joint of the model's only knee with contact meshes, and its bodies.

    Raises
    ------
    InputError
        If there is no such knee, or more than one.
    """
    carriers = {body_of(model, x) for x in contact_meshes(model)}
    femora = sorted(x for x in carriers if "femur" in x.lower())
    tibiae = sorted(x for x in carriers if "tibia" in x.lower())
    for bone, found in (("femur", femora), ("tibia", tibiae)):
        if len(found) != 1:
            raise model.refusal(
                "contact geometry",
                f"one {bone} with a contact mesh is wanted, found {', '.join(found) or 'none'}",
                f"Give a model of one knee whose {bone} is called so and has a contact mesh.",
            )
    femoral, tibial = model.welded(femora[0]), model.welded(tibiae[0])
    for joint in model.joints:
        if joint.parent in femoral and joint.child in tibial:
            break
    else:
        raise model.refusal(
            "joints",
            f"no joint leads from {femora[0]} to {tibiae[0]}",
            "Only knees with one joint between femur (its parent) and tibia are supported.",
        )
    to_parent = (femoral[joint.parent] @ joint.parent_frame).inverse
    tibia_frame = model.displacement(joint)
    to_child = tibia_frame @ (tibial[joint.child] @ joint.child_frame).inverse
    return Bones(
        model=model,
        joint=joint,
        side=_side(model, femora[0], joint.name, tibiae[0]),
        femur={name: to_parent @ place for name, place in femoral.items()},
        tibia={name: to_child @ place for name, place in tibial.items()},
        tibia_frame=tibia_frame,
    )


def _side(model: OsimModel, *names: str) -> Side:
    """The side that the names of bodies and joint end with."""
    for name in names:
        found = re.search(r"(?:^|[_\-. ])(r|right|l|left)(?:[_\-. ]|$)", name.lower())
        if found:
            return "right" if found[1].startswith("r") else "left"
    raise model.refusal(
        "bodies",
        f"neither of {', '.join(names)} says which side it is of",
        "Let the name of the femur end with _r or _l.",
    )


def body_of(model: OsimModel, mesh: Element) -> str:
    """Body that a contact mesh is fixed to."""
    return model.placed(mesh.findtext("socket_frame", ""))[0]
