"""What of an OpenSim model has no place in a knee, as one list."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from identknee.subject.opensim import (
    CONTACT_LAW,
    LIGAMENT_CLASS,
    MESH_CLASSES,
    Bones,
    ImportedKnee,
    NotTaken,
    contact_meshes,
    ends_of,
    is_muscle,
    other_ligaments,
    remark,
    side_in,
)
from identknee.subject.opensim_model import Element

# Sets of a model that are not read, and why.
UNREAD = {
    "ConstraintSet": "constraints are not read: the knee moves freely in five coordinates",
    "ControllerSet": "there is no control",
    "ProbeSet": "results follow from the trials alone",
    "MarkerSet": "markers are not read",
}
CONTACT_NUMBERS = ("elastic_modulus", "poissons_ratio", "thickness")
LINEAR = ("LinearFunction", "Constant")


def left_out_of(found: ImportedKnee) -> tuple[NotTaken, ...]:
    """All that was left out of the model or changed, what the knee rests on first.

    Elements of one class that are left out for the same reason are one entry.
    """
    bones = found.bones
    remarks = [
        *found.not_taken,
        *_forces(bones),
        *_motion(bones),
        *_contact(bones),
        *_bodies(bones),
        *(remark(x, why) for group, why in UNREAD.items() for x in bones.model.listed(group)),
    ]
    return tuple(_joined(remarks))


def _joined(remarks: Iterable[NotTaken]) -> Iterator[NotTaken]:
    """Elements of one class that are left out or changed for the same reason, as one entry."""
    groups: dict[tuple[str, str, str], list[NotTaken]] = {}
    for x in remarks:
        groups.setdefault((x.kind, x.change, x.why), []).append(x)
    for own in groups.values():
        yield replace(own[0], names=tuple(name for x in own for name in x.names))


def _forces(bones: Bones) -> Iterator[NotTaken]:
    own = {x.get("name") for x in bones.joint.element.iterfind("coordinates/Coordinate")}
    lines = other_ligaments(bones)
    for x in lines:
        yield remark(x, f"only lines of class {LIGAMENT_CLASS} are read", is_line=True)
    for x in bones.model.forces:
        if x in lines:
            continue
        coordinate = (x.findtext("coordinate") or "").strip().split("/")[-1]
        ends = set(ends_of(bones, x))
        if x.tag == LIGAMENT_CLASS:
            if x.find("GeometryPath/PathPointSet/objects/*") is None:
                yield remark(x, "its path has no points", is_line=True)
            elif ends != {"femur", "tibia"}:
                yield remark(x, "it does not lead from the femur to the tibia of this knee")
            elif float((x.findtext("damping_coefficient") or "0").split()[0]):
                yield remark(x, "damping is left out: there is no time", "changed")
        elif "Contact" in x.tag or x.tag in ("ElasticFoundationForce", "HuntCrossleyForce"):
            yield remark(x, CONTACT_LAW, "changed")
        elif is_muscle(x):
            yield remark(x, "no muscle pulls")
        elif coordinate in own:
            yield remark(x, "it acts on a coordinate of this knee, and its class is not read")
        elif ends or _bodies_of(bones, x):
            yield remark(x, "it acts on a bone of this knee, and its class is not read")
        else:
            yield remark(x, "it acts on no bone of this knee")


def _bodies_of(bones: Bones, force: Element) -> set[str]:
    """The bodies of this knee that a force names in its sockets and on its path."""
    named = {
        bones.model.placed(text)[0]
        for x in force.iter()
        if x.tag.startswith("socket_") and (text := (x.text or "").strip())
    }
    return named & {*bones.femur, *bones.tibia}


def _motion(bones: Bones) -> Iterator[NotTaken]:
    """What the joint states of the knee's motion that is not in it."""
    joint = bones.joint.element
    axes = joint.findall("SpatialTransform/TransformAxis")
    driven = [(x.findtext("coordinates") or "").split() for x in axes]
    units = {
        name: " m" if (x.get("name") or "").startswith("translation") else " rad"
        for x, own in zip(axes, driven, strict=True)
        for name in own
    }
    for x in joint.iterfind("coordinates/Coordinate"):
        default = float((x.findtext("default_value") or "0").split()[0])
        if default:
            said = f"{default:g}{units.get(x.get('name', ''), '')}"
            yield remark(x, f"it is taken as zero, not as its default {said}", "changed")
        if (x.findtext("locked") or "").strip() == "true":
            yield remark(x, "it is locked in the model, and free here", "changed")
    several = {name for own in driven for name in own if sum(name in x for x in driven) > 1}
    for x, own in zip(axes, driven, strict=True):
        functions = {y.tag for y in x if y.tag.endswith((*LINEAR, "Function", "Spline"))}
        is_coupled = own and (several & set(own) or not functions <= {*LINEAR})
        if is_coupled and x.get("name") != "rotation1":
            why = f"its motion with {own[0]} is left out: the knee moves freely in five coordinates"
            yield remark(x, why)


def _contact(bones: Bones) -> Iterator[NotTaken]:
    own = {*bones.femur, *bones.tibia}
    meshes = {id(x) for x in contact_meshes(bones.model)}
    for x in bones.model.listed("ContactGeometrySet"):
        body = bones.model.placed(x.findtext("socket_frame") or "/ground")[0]
        if body not in own:
            yield remark(x, "it is on another body")
        elif id(x) not in meshes:
            yield remark(x, f"only {' and '.join(MESH_CLASSES)} are read")
        elif any(x.find(f".//{y}") is not None for y in CONTACT_NUMBERS):
            yield remark(x, CONTACT_LAW, "changed")


def _bodies(bones: Bones) -> Iterator[NotTaken]:
    own, other = {*bones.femur, *bones.tibia}, "left" if bones.side == "right" else "right"
    for x in bones.model.listed("BodySet"):
        name = x.get("name", "")
        if name in own:
            for wrap in x.iterfind("WrapObjectSet/objects/*"):
                yield remark(wrap, "nothing wraps: lines are straight")
        else:
            of_leg = side_in(name) == other
            yield remark(x, "it is of the other leg" if of_leg else "it is no bone of this knee")
    for x in bones.model.listed("JointSet"):
        if x is not bones.joint.element and x.tag != "WeldJoint":
            yield remark(x, "it is not the joint of this knee")
