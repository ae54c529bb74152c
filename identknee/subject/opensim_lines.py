"""The ligaments of a knee in an OpenSim model."""

from collections.abc import Mapping, Sequence

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.subject.ligament import Ligament
from identknee.subject.opensim_bones import Bones
from identknee.subject.opensim_model import MM_PER_M, Element, OsimModel, Transform

LIGAMENT_CLASS = "Blankevoort1991Ligament"
TRANSITION_STRAIN = 0.06
# How the bundles of the four single lines begin; the first beginning that occurs is taken, so that
# the deep and posterior bundles of the medial collateral ligament stay out of its line.
MERGED = {"ACL": ("ACL",), "PCL": ("PCL",), "LCL": ("LCL",), "MCL": ("MCLs", "sMCL", "MCL")}


@declared
class OsimEnd:
    """Where a ligament holds on to a bone."""

    element: Element = entry("The XML of its point")
    frame: Transform = entry("Where the frame in which that is given is in the common frame [m]")


@declared
class OsimLine:
    """A ligament between femur and tibia, with the XML it was read from."""

    ligament: Ligament = entry("What it is here, on the side that the model is of")
    element: Element = entry("Its XML")
    ends: Mapping[str, OsimEnd] = entry("Its femoral and its tibial end, by bone")


def lines_of(bones: Bones) -> tuple[list[OsimLine], list[str]]:
    """The ligaments between femur and tibia, and what to say about those not taken exactly.

    Raises
    ------
    InputError
        If there is none, or one cannot be used.
    """
    model = bones.model
    lines: list[OsimLine] = []
    bent, stiffening = [], []
    for element in model.all_of(LIGAMENT_CLASS):
        ends = _ends(bones, element)
        if ends is None:
            continue
        name = element.get("name", "")
        ligament = _ligament(model, element, {x: _place(model, end) for x, end in ends.items()})
        lines.append(OsimLine(ligament=ligament, element=element, ends=ends))
        if _is_bent(element):
            bent.append(name)
        if model.numbers(element, "transition_strain", "0.06")[0] != TRANSITION_STRAIN:
            stiffening.append(name)
    if not lines:
        raise model.refusal(
            "forces",
            f"no {LIGAMENT_CLASS} leads from the femur to the tibia",
            "Give a model whose ligaments are of that class.",
        )
    remarks = []
    if bent:
        remarks.append(f"Straight lines replace paths that wrap or bend: {', '.join(bent)}.")
    if stiffening:
        remarks.append(f"The transition strain 0.06 replaces that of {', '.join(stiffening)}.")
    return lines, remarks


def merged(model: OsimModel, ligaments: Sequence[Ligament]) -> list[Ligament]:
    """The four single lines, each from the bundles whose names begin with its own.

    Raises
    ------
    InputError
        If one of them has no bundle.
    """
    lines = []
    for name in MERGED:
        bundle = bundle_of(name, ligaments)
        if not bundle:
            raise model.refusal(
                "forces",
                f"no ligament's name begins with {' or '.join(MERGED[name])}",
                "Import the bundles separately, or rename them.",
            )
        lines.append(line_for(name, bundle))
    return lines


def bundle_of(name: str, ligaments: Sequence[Ligament]) -> list[Ligament]:
    """The bundles of one of the four single lines."""
    for beginning in MERGED[name]:
        bundle = [x for x in ligaments if x.name.lower().startswith(beginning.lower())]
        if bundle:
            return bundle
    return []


def line_for(name: str, bundle: Sequence[Ligament]) -> Ligament:
    """One line for a bundle: mean ends, the sum of the stiffnesses, the strain they weight."""
    stiffness = np.array([x.stiffness_kN for x in bundle])
    strain = np.array([x.reference_strain_pct for x in bundle])
    total = float(stiffness.sum())
    return Ligament(
        name=name,
        femur=np.mean([x.femur for x in bundle], axis=0),
        tibia=np.mean([x.tibia for x in bundle], axis=0),
        stiffness_kN=total,
        reference_strain_pct=float(np.average(strain, weights=stiffness if total else None)),
    )


def slack_length(ligament: Ligament) -> float:
    """Length at which a ligament begins to pull [m].

    Examples
    --------
    >>> ends = {"femur": np.zeros(3), "tibia": np.array([0.0, -33.0, 0.0])}
    >>> line = Ligament(name="ACL", **ends, stiffness_kN=10.0, reference_strain_pct=10.0)
    >>> round(slack_length(line), 12)
    0.03
    """
    return ligament.length / MM_PER_M / (1.0 + ligament.reference_strain_pct / 100.0)


def _ends(bones: Bones, element: Element) -> dict[str, OsimEnd] | None:
    """Femoral and tibial end of a ligament; None if it has none there."""
    points = element.findall("GeometryPath/PathPointSet/objects/*")
    if len(points) < 2:
        return None
    ends: dict[str, OsimEnd] = {}
    for point in (points[0], points[-1]):
        body, frame = bones.model.placed(point.findtext("socket_parent_frame", ""))
        for bone, bodies in (("femur", bones.femur), ("tibia", bones.tibia)):
            if body in bodies:
                ends[bone] = OsimEnd(element=point, frame=bodies[body] @ frame)
    return ends if len(ends) == 2 else None


def _place(model: OsimModel, end: OsimEnd) -> Array:
    """Where an end is in the common frame [m]."""
    return end.frame(model.vector(end.element, "location"))


def _is_bent(element: Element) -> bool:
    path = "GeometryPath"
    return (
        len(element.findall(f"{path}/PathPointSet/objects/*")) > 2
        or element.find(f"{path}/PathWrapSet/objects/PathWrap") is not None
    )


def _ligament(model: OsimModel, element: Element, ends: Mapping[str, Array]) -> Ligament:
    name = element.get("name", "")
    slack = model.number(element, "slack_length")
    if slack <= 0.0:
        raise model.refusal(
            f"ligament {name}", f"its slack length is {slack:g} m", "Give a positive one."
        )
    length = float(np.linalg.norm(ends["tibia"] - ends["femur"]))
    try:
        return Ligament(
            name=name,
            femur=ends["femur"] * MM_PER_M,
            tibia=ends["tibia"] * MM_PER_M,
            stiffness_kN=model.number(element, "linear_stiffness") / 1000.0,
            reference_strain_pct=100.0 * (length / slack - 1.0),
        )
    except ValueError as error:
        raise InputError(
            model.path, f"ligament {name}", str(error), "Correct it in the model."
        ) from error
