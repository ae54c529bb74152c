"""What of an OpenSim model has no place in a knee, as one list."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from identknee.subject.opensim import (
    CONTACT_LAW,
    LIGAMENT_CLASS,
    MESH_CLASSES,
    Bones,
    Change,
    ImportedKnee,
    NotTaken,
    contact_meshes,
    ends_of,
    is_muscle,
    other_ligaments,
    side_in,
)
from identknee.subject.opensim_model import Element, OsimModel

# Sets of a model of which nothing is read, with what is said of them.
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

    Everything of a class about which the same is to be said is one entry.
    """
    bones = found.bones
    told = [
        *found.not_taken,
        *_forces(bones),
        *_motion(bones),
        *_contact(bones),
        *_bodies(bones),
        *_sets(bones.model),
    ]
    return tuple(_joined(told))


def _joined(told: Iterable[NotTaken]) -> Iterator[NotTaken]:
    """Entries of one class about which the same is said, as one."""
    groups: dict[tuple[str, str, str], list[NotTaken]] = {}
    for x in told:
        groups.setdefault((x.kind, x.change, x.why), []).append(x)
    for own in groups.values():
        yield replace(own[0], names=tuple(name for x in own for name in x.names))


def _one(
    element: Element, why: str, *, is_changed: bool = False, is_line: bool = False
) -> NotTaken:
    name = element.get("name") or "without a name"
    change: Change = "changed" if is_changed else "left out"
    return NotTaken(kind=element.tag, names=(name,), change=change, why=why, is_line=is_line)


def _forces(bones: Bones) -> Iterator[NotTaken]:
    own = {x.get("name") for x in bones.joint.element.iterfind("coordinates/Coordinate")}
    lines = other_ligaments(bones)
    for x in lines:
        why = f"only lines of class {LIGAMENT_CLASS} are read"
        yield _one(x, why, is_line=True)
    for x in bones.model.forces:
        if x in lines:
            continue
        coordinate = (x.findtext("coordinate") or "").strip().split("/")[-1]
        ends = set(ends_of(bones, x))
        if x.tag == LIGAMENT_CLASS:
            if x.find("GeometryPath/PathPointSet/objects/*") is None:
                yield _one(x, "its path has no points", is_line=True)
            elif ends != {"femur", "tibia"}:
                yield _one(x, "it does not lead from the femur to the tibia of this knee")
            elif float((x.findtext("damping_coefficient") or "0").split()[0]):
                yield _one(x, "damping is left out: there is no time", is_changed=True)
        elif "Contact" in x.tag or x.tag in ("ElasticFoundationForce", "HuntCrossleyForce"):
            yield _one(x, CONTACT_LAW, is_changed=True)
        elif is_muscle(x):
            yield _one(x, "no muscle pulls")
        elif coordinate in own:
            yield _one(x, "it acts on a coordinate of this knee, and its class is not read")
        elif ends or _bodies_of(bones, x):
            yield _one(x, "it acts on a bone of this knee, and its class is not read")
        else:
            yield _one(x, "it acts on no bone of this knee")


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
    for x in joint.iterfind("coordinates/Coordinate"):
        default = float((x.findtext("default_value") or "0").split()[0])
        if default:
            why = f"it is taken as zero, not as its default {default:g}"
            yield _one(x, why, is_changed=True)
        if (x.findtext("locked") or "").strip() == "true":
            yield _one(x, "it is locked in the model, and free here", is_changed=True)
    axes = joint.findall("SpatialTransform/TransformAxis")
    driven = [(x.findtext("coordinates") or "").split() for x in axes]
    several = [x for x in {name for own in driven for name in own} if _count(driven, x) > 1]
    for x, own in zip(axes, driven, strict=True):
        functions = {y.tag for y in x if y.tag.endswith((*LINEAR, "Function", "Spline"))}
        is_coupled = own and (set(own) & set(several) or not functions <= {*LINEAR})
        if is_coupled and x.get("name") != "rotation1":
            why = f"its motion with {own[0]} is left out: the knee moves freely in five coordinates"
            yield _one(x, why)


def _count(driven: Iterable[list[str]], name: str) -> int:
    return sum(name in x for x in driven)


def _contact(bones: Bones) -> Iterator[NotTaken]:
    own = {*bones.femur, *bones.tibia}
    meshes = {id(x) for x in contact_meshes(bones.model)}
    for x in bones.model.listed("ContactGeometrySet"):
        body = bones.model.placed(x.findtext("socket_frame") or "/ground")[0]
        if body not in own:
            yield _one(x, "it is on another body")
        elif id(x) not in meshes:
            yield _one(x, f"only {' and '.join(MESH_CLASSES)} are read")
        elif any(x.find(f".//{y}") is not None for y in CONTACT_NUMBERS):
            yield _one(x, CONTACT_LAW, is_changed=True)


def _bodies(bones: Bones) -> Iterator[NotTaken]:
    own, other = {*bones.femur, *bones.tibia}, "left" if bones.side == "right" else "right"
    for x in bones.model.listed("BodySet"):
        name = x.get("name", "")
        if name in own:
            for wrap in x.iterfind("WrapObjectSet/objects/*"):
                yield _one(wrap, "nothing wraps: lines are straight")
        else:
            of_leg = side_in(name) == other
            yield _one(x, "it is of the other leg" if of_leg else "it is no bone of this knee")
    for x in bones.model.listed("JointSet"):
        if x is not bones.joint.element and x.tag != "WeldJoint":
            yield _one(x, "it is not the joint of this knee")


def _sets(model: OsimModel) -> Iterator[NotTaken]:
    for group, why in UNREAD.items():
        for x in model.listed(group):
            yield _one(x, why)
