"""OpenSim 4 models: their XML, their frames and their joints."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from identknee.runs.declare import Array, declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, check_readable
from identknee.runs.schema import shown
from identknee.subject.surface import Surface

Element = ET.Element
MM_PER_M = 1000.0
# Larger numbers are refused: no quantity of a knee comes near, and their products may overflow.
LARGEST = 1e9
LIGAMENT_CLASS = "Blankevoort1991Ligament"
# Endings of the names of force classes.
FORCE_ENDINGS = ("Force", "Spring", "Ligament", "Actuator")
# Where a force has the points of its path, by version of OpenSim.
PATHS = ("*/PathPointSet", "path/*/PathPointSet")
# Largest depth of frames within frames, and of functions of functions.
DEEPEST = 100
# Code of the XML parser's error for a character that is not allowed at its place.
INVALID_TOKEN = 4
# Joints whose displacement is zero while their coordinates are zero.
ZERO_JOINTS = (
    "WeldJoint",
    "PinJoint",
    "SliderJoint",
    "BallJoint",
    "FreeJoint",
    "GimbalJoint",
    "PlanarJoint",
    "UniversalJoint",
)


@declared
class Transform:
    """Where a frame is in another: ``rotation @ point + translation``, lengths in m."""

    rotation: Array = entry("Rotation, shape ``(3, 3)``")
    translation: Array = entry("Translation [m], shape ``(3,)``")

    def __matmul__(self, other: "Transform") -> "Transform":
        return Transform(
            rotation=self.rotation @ other.rotation, translation=self(other.translation)
        )

    def __call__(self, points: Array) -> Array:
        """Points ``(..., 3)`` of this frame [m] in the outer one."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def moved(self, surface: Surface) -> Surface:
        """The surface of this frame [m] in the outer one."""
        return surface.moved(self.rotation, self.translation)

    @property
    def inverse(self) -> "Transform":
        """The inverse transform: the outer frame seen from this one."""
        turned = self.rotation.T
        return Transform(rotation=turned, translation=-turned @ self.translation)


IDENTITY = Transform(rotation=np.eye(3), translation=np.zeros(3))


@declared
class Joint:
    """A joint between two bodies."""

    name: str = entry("Name of the joint")
    kind: str = entry("Its class")
    parent: str = entry("Name of the parent body")
    child: str = entry("Name of the child body")
    parent_frame: Transform = entry("Where the joint's frame is in the parent body")
    child_frame: Transform = entry("Where it is in the child body")
    element: Element = entry("Its XML")


class OsimModel:
    """An OpenSim 4 model file.

    Attributes
    ----------
    path
        The file.
    root
        Its XML.
    joints
        All of its joints.
    """

    def __init__(self, path: PathLike) -> None:
        self.path: Path = check_readable(path)
        content = self.path.read_bytes()
        try:
            root = ET.fromstring(content)
        except ET.ParseError as error:
            where, why, remedy = _broken_at(content, error)
            raise InputError(self.path, where, why, remedy) from error
        except (ValueError, LookupError) as error:
            raise InputError(
                self.path, "", f"this is not valid XML: {error}", "Save the model again."
            ) from error
        found = root.find("Model")
        if root.tag != "OpenSimDocument" or found is None:
            raise self.refusal(
                "", "this is not an OpenSim model", "Give the .osim file of a model."
            )
        if not root.get("Version", "").startswith("4"):
            raise self.refusal(
                "",
                f"the file is of version {root.get('Version', '?')}, not of OpenSim 4",
                "Open it in OpenSim 4 and save it again.",
            )
        units = (found.findtext("length_units") or "m").strip()
        if units not in ("m", "meters"):
            raise self.refusal(
                "length_units", f"lengths are in {units}", "Save the model in metres."
            )
        self.root: Element = root
        self._model = found
        defaults = found.find("defaults")
        self._defaults = [] if defaults is None else list(defaults)
        self._passed = {id(y) for x in self._defaults for y in x.iter()}
        self._take_defaults()
        self._offsets = {
            (joint.get("name", ""), frame.get("name", "")): frame
            for joint in found.iterfind("JointSet/objects/*")
            for frame in joint.iterfind("frames/PhysicalOffsetFrame")
        }
        self.joints = tuple(self._joint(x) for x in found.iterfind("JointSet/objects/*"))

    def all_of(self, kind: str) -> list[Element]:
        """All elements of a class that have a name, defaults excepted."""
        return [x for x in self._of(kind) if x.get("name")]

    def _of(self, kind: str | None = None) -> list[Element]:
        """All elements of a class, or of any, defaults excepted."""
        return [x for x in self._model.iter(kind) if id(x) not in self._passed]

    def _take_defaults(self) -> None:
        """Write into ligaments what they leave to the default of their class, as OpenSim does."""
        own = [x for x in self._defaults if x.tag == LIGAMENT_CLASS]
        for line in self._of(LIGAMENT_CLASS):
            line.extend(y for x in own for y in x if line.find(y.tag) is None)

    @property
    def forces(self) -> list[Element]:
        """Its forces of all classes, wherever they stand; sets of forces by their members."""
        of_set = {id(x) for x in self._model.iterfind("ForceSet/objects/*")}
        return [
            x
            for x in self._of()
            if x.find("objects") is None
            and (
                id(x) in of_set
                or (
                    x.get("name")
                    and (x.tag.endswith(FORCE_ENDINGS) or any(x.find(y) is not None for y in PATHS))
                )
            )
        ]

    def listed(self, group: str) -> list[Element]:
        """The elements of one of its sets, such as ``"BodySet"``."""
        return list(self._model.iterfind(f"{group}/objects/*"))

    def refusal(self, where: str, why: str, remedy: str) -> InputError:
        """The error to raise about this file."""
        return InputError(self.path, where, why, remedy)

    def vector(self, element: Element, tag: str, default: str | None = None) -> Array:
        """The three numbers of a child element, shape ``(3,)``."""
        values = self.numbers(element, tag, default)
        if values.shape != (3,):
            raise self._malformed(element, tag, "three numbers")
        return values

    def number(self, element: Element, tag: str) -> float:
        """The one number of a child element."""
        values = self.numbers(element, tag)
        if values.shape != (1,):
            raise self._malformed(element, tag, "one number")
        return float(values[0])

    def number_or_zero(self, element: Element, tag: str) -> float:
        """The first number of a child element; 0 where there is none."""
        text = (element.findtext(tag) or "").strip()
        return float(self.numbers(element, tag)[0]) if text else 0.0

    def numbers(self, element: Element, tag: str, default: str | None = None) -> Array:
        """The finite numbers of a child element."""
        text = element.findtext(tag, default)
        try:
            values = np.array([float(x) for x in (text or "").split()])
        except ValueError:
            raise self._malformed(element, tag, "numbers") from None
        if len(values) == 0 or not np.isfinite(values).all():
            raise self._malformed(element, tag, "finite numbers")
        if np.abs(values).max() > LARGEST:
            raise self._malformed(element, tag, f"numbers up to {LARGEST:g}")
        return values

    def transform(self, element: Element, orientation: str) -> Transform:
        """Where a frame is in its outer one, from its X-Y-Z `orientation` and translation."""
        turns = self.vector(element, orientation, "0 0 0")
        return Transform(
            rotation=_about(0, turns[0]) @ _about(1, turns[1]) @ _about(2, turns[2]),
            translation=self.vector(element, "translation", "0 0 0"),
        )

    def placed(self, reference: str, joint: str = "", *, depth: int = 0) -> tuple[str, Transform]:
        """Body of a frame that a socket refers to, and where the frame is in that body.

        Parameters
        ----------
        reference
            A path such as ``/bodyset/femur_r``, or the name of a frame of the joint itself.
        joint
            The joint whose socket it is, where it is one's.
        depth
            In how many frames it is already.
        """
        if depth > DEEPEST:
            raise self.refusal(
                joint,
                f"frames lie in one another more than {DEEPEST} deep, or in a circle",
                "Open the model in OpenSim 4 and save it.",
            )
        parts = [x for x in reference.strip().split("/") if x not in ("", "..", ".")]
        if not parts:
            raise self.refusal(
                joint, "a frame is missing", "Open the model in OpenSim 4 and save it."
            )
        owner = parts[-2] if len(parts) > 1 else joint
        offset = self._offsets.get((owner, parts[-1]))
        if offset is None:
            return parts[-1], IDENTITY
        inner = self.transform(offset, "orientation")
        parent = offset.findtext("socket_parent", "")
        body, outer = self.placed(parent, owner, depth=depth + 1)
        return body, outer @ inner

    def welded(self, body: str) -> dict[str, Transform]:
        """The bodies welded to `body`, itself included, each with where it is in `body`."""
        group = {body: IDENTITY}
        waiting = [body]
        welds = [x for x in self.joints if x.kind == "WeldJoint"]
        while waiting:
            here = waiting.pop()
            for weld in welds:
                across = weld.parent_frame @ weld.child_frame.inverse
                for near, far, step in (
                    (weld.parent, weld.child, across),
                    (weld.child, weld.parent, across.inverse),
                ):
                    if near == here and far not in group:
                        group[far] = group[here] @ step
                        waiting.append(far)
        return group

    def displacement(self, joint: Joint) -> Transform:
        """Where the joint's child frame is in its parent frame, all coordinates being zero."""
        if joint.kind in ZERO_JOINTS:
            return IDENTITY
        axes = {x.get("name"): x for x in joint.element.iterfind("SpatialTransform/TransformAxis")}
        if joint.kind != "CustomJoint":
            raise self.refusal(
                f"joint {joint.name}",
                f"joints of class {joint.kind} are not supported",
                "Replace it by a CustomJoint.",
            )
        if not axes:
            raise self.refusal(
                f"joint {joint.name}",
                "this CustomJoint has no SpatialTransform",
                "Give it one with its rotation and translation axes.",
            )
        rotation, translation = np.eye(3), np.zeros(3)
        for i in (1, 2, 3):
            turn, shift = axes.get(f"rotation{i}"), axes.get(f"translation{i}")
            if turn is not None:
                axis = self.vector(turn, "axis")
                if not axis.any():
                    raise self._malformed(turn, "axis", "a direction")
                rotation = rotation @ _turned(axis, self._at_zero(turn, joint.name))
            if shift is not None:
                translation = translation + self.vector(shift, "axis") * self._at_zero(
                    shift, joint.name
                )
        return Transform(rotation=rotation, translation=translation)

    def _joint(self, element: Element) -> Joint:
        name = element.get("name", "")
        parent, parent_frame = self.placed(element.findtext("socket_parent_frame", ""), name)
        child, child_frame = self.placed(element.findtext("socket_child_frame", ""), name)
        return Joint(
            name=name,
            kind=element.tag,
            parent=parent,
            child=child,
            parent_frame=parent_frame,
            child_frame=child_frame,
            element=element,
        )

    def _at_zero(self, element: Element, joint: str, *, depth: int = 0) -> float:
        """Value at zero of the function that an element holds."""
        function = next((x for x in element if x.get("name") == "function"), None)
        if function is None:
            nested = element.find("function")
            function = nested[0] if nested is not None and len(nested) else None
        if function is None:
            return 0.0
        if function.tag == "Constant":
            return self.number(function, "value")
        if function.tag in ("LinearFunction", "PolynomialFunction"):
            return float(self.numbers(function, "coefficients")[-1])
        if function.tag == "MultiplierFunction" and depth < DEEPEST:
            inner = self._at_zero(function, joint, depth=depth + 1)
            return self.number(function, "scale") * inner
        if function.tag in ("SimmSpline", "PiecewiseLinearFunction"):
            x, y = self.numbers(function, "x"), self.numbers(function, "y")
            # At a knot a spline has the knot's value, whatever its kind.
            if 0.0 in x and len(x) == len(y):
                return float(y[np.flatnonzero(x == 0.0)[0]])
        raise self.refusal(
            f"joint {joint}",
            f"its function {function.tag} cannot be evaluated at zero",
            "Use a constant, a linear function or a spline with a knot at zero.",
        )

    def _malformed(self, element: Element, tag: str, wanted: str) -> InputError:
        text = element.findtext(tag)
        why = f"<{tag}> must hold {wanted}, got {shown(text)}"
        remedy = "Open the model in OpenSim 4 and save it again."
        if "," in (text or ""):
            remedy = "Write numbers with decimal points, and spaces between them."
        if element.find(tag) is None:
            why = f"<{tag}> is missing"
        return self.refusal(
            f"{element.tag} {element.get('name', '')}".strip(),
            why,
            remedy,
        )


# Characters that begin markup in XML, and how they are written in text.
WRITTEN = {"&": "&amp;", "<": "&lt;"}
# Code points to which bytes that are not UTF-8 are decoded, and those that XML does not allow.
BYTES, NO_CHARACTERS = range(0xDC80, 0xDD00), (0xFFFE, 0xFFFF)


def _broken_at(content: bytes, error: ET.ParseError) -> tuple[str, str, str]:
    """Where XML breaks off, why, and what to do: the character is named."""
    line, column = error.position
    # The parser counts characters; what is none in UTF-8 stays one byte each.
    rows = content.decode("utf-8", "surrogateescape").split("\n")
    row = rows[line - 1] if line <= len(rows) else ""
    found = row[column : column + 1]
    if error.code != INVALID_TOKEN or not found:
        why = f"this is not valid XML: {error}"
        return f"line {line}, column {column + 1}", why, "Save the model again."
    number = ord(found)
    # It is noticed only after the character that begins a name or a tag.
    began = max(row.rfind(x, 0, column + 1) for x in "<>")
    if (name := row.rfind("&", 0, column + 1)) >= 0 and ";" not in row[name:column]:
        began = name
    if number in BYTES:
        why, remedy = f"the byte 0x{number - 0xDC00:02X} is no UTF-8", "Save the file as UTF-8."
    elif number < ord(" ") or number in NO_CHARACTERS:
        why, remedy = f"the character U+{number:04X} is not allowed", "Remove it."
    elif began >= 0 and row[began] in WRITTEN:
        column, found = began, row[began]
        why = f"the character {found} begins what is not valid there"
        remedy = f"Write {WRITTEN[found]} where it is meant as a character."
    else:
        why, remedy = f"the character {found} is not allowed there", "Correct or remove it."
    return f"line {line}, column {column + 1}", f"this is not valid XML: {why}", remedy


def _about(axis: int, angle: float) -> Array:
    return _turned(np.eye(3)[axis], angle)


def _turned(axis: Array, angle: float) -> Array:
    """Rotation by `angle` [rad] about `axis` (3,), by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
