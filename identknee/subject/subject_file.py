"""What a subject.toml may hold, and how a message about it names the place."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, StringConstraints, model_validator

from identknee.runs.arrays import too_far
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike
from identknee.runs.schema import (
    Fault,
    Number,
    Part,
    Place,
    otherwise,
    read_toml,
    refusal,
    remedy_of,
    validated,
)

FORMAT = 1


def _near(coordinate: float) -> float:
    if far := too_far(coordinate):
        why, _, remedy = far.partition("; ")
        raise refusal(f"the point lies {why}", f"{remedy.capitalize()}.")
    return coordinate


Text = Annotated[str, StringConstraints(strip_whitespace=True)]
Point = Annotated[
    list[Annotated[Number, AfterValidator(_near)]],
    Field(min_length=3, max_length=3),
    otherwise("three numbers are wanted, got {}", "Write [x, y, z] with points in mm."),
]
_EXAMPLES = {
    "format": f"format = {FORMAT}",
    "name": 'name = "..." (any text)',
    "side": 'side = "right" or side = "left"',
    "description": 'description = "..."',
    "surfaces": "[surfaces] with femur, tibia_medial and tibia_lateral",
    "femur": "femur (a file under [surfaces], a frame under [frames], [x, y, z] in mm elsewhere)",
    "tibia": "tibia (a frame under [frames], [x, y, z] in mm for a ligament)",
    "tibia_medial": 'tibia_medial = "FILE.stl"',
    "tibia_lateral": 'tibia_lateral = "FILE.stl"',
    "frames": "[frames.femur] and [frames.tibia], or [landmarks] with the epicondyles",
    "origin": "origin = [x, y, z] in mm",
    "axes": "axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]] (rows: anterior, superior, right)",
    "ligaments": "a table [[ligaments]] for each ligament",
    "stiffness_kN": "stiffness_kN = ... (kN per unit strain)",
    "reference_strain_pct": "reference_strain_pct = ... (% in the scanned pose)",
}
_TABLE = "{} is not a table"


class SurfaceFiles(Part):
    """``[surfaces]``: the files of the surfaces."""

    femur: Text
    tibia_medial: Text
    tibia_lateral: Text


class FrameTable(Part):
    """``[frames.femur]`` or ``[frames.tibia]``."""

    origin: Point
    axes: Annotated[
        list[Point],
        Field(min_length=3, max_length=3),
        otherwise("three rows are wanted", f"Write {_EXAMPLES['axes']}."),
    ]


class FrameTables(Part):
    """``[frames]``."""

    femur: Annotated[FrameTable, otherwise(_TABLE, "Write it below a line [frames.femur].")]
    tibia: Annotated[FrameTable, otherwise(_TABLE, "Write it below a line [frames.tibia].")]


class LigamentTable(Part):
    """A ``[[ligaments]]``."""

    name: Text
    femur: Point
    tibia: Point
    stiffness_kN: Number  # noqa: N815 - the unit
    reference_strain_pct: Number


class LineTable(Part):
    """A line of force of an effect."""

    femur: Point
    tibia: Point


class EffectTable(Part):
    """A ``[[effects]]``."""

    name: Text
    values: Annotated[
        dict[str, Number], otherwise(_TABLE, "Write it below a line [effects.values].")
    ] = Field(default_factory=dict)
    fixed: Annotated[
        list[str], otherwise("{} is not a list of texts", 'Write fixed = ["...", "..."].')
    ] = Field(default_factory=list)
    lines: Annotated[
        list[LineTable],
        Field(min_length=1),
        otherwise("a list of tables is wanted", "Write each below a line [[effects.lines]]."),
    ] = Field(default_factory=list)
    stiffness_sd_kN: Number | None = None  # noqa: N815 - the unit
    site_sd_mm: Number | None = None


Spread = Annotated[
    Number | list[Point],
    otherwise("{} is no spread", "Write a standard deviation in mm or three rows of mm^2."),
]


class BoneSpreads(Part):
    """How far the two insertions of a ligament may be off."""

    femur: Spread = 0.0
    tibia: Spread = 0.0


class GroupTable(Part):
    """A ``[[groups]]``: ligaments whose parameters are tied."""

    name: Text
    members: Annotated[
        list[str], otherwise("{} is not a list of texts", 'Write members = ["...", "..."].')
    ]


class PoseTable(Part):
    """A ``[[poses]]``: where the knee is known to be."""

    flexion_deg: Number
    coordinates: Annotated[
        list[Number],
        Field(min_length=5, max_length=5),
        otherwise(
            "five numbers are wanted, got {}",
            "Write [lateral shift, anterior drawer, distraction, varus, internal] in mm and deg.",
        ),
    ]


class UncertaintyTable(Part):
    """``[uncertainty]``, any of it."""

    insertions_mm: Annotated[
        Number | dict[str, BoneSpreads],
        otherwise("{} is no spread", "Write insertions_mm = 2.0, or a table by ligament and bone."),
    ] = 0.0
    registration_deg: Number = 0.0
    registration_mm: Number = 0.0
    load_axes_deg: Number = 0.0
    load_gain: Number = 0.0
    flexion_deg: Number = 0.0
    trial_flexion_deg: Number = 0.0
    contact_modulus: Number = 0.0
    contact_exponent: Number = 0.0
    surface_mm: Number = 0.0
    zero_mm: Number = 0.0
    zero_deg: Number = 0.0
    reference_pose_deg: Number = 0.0
    reference_pose_mm: Number = 0.0
    toe_region: Number = 0.0


class PriorTable(Part):
    """A ``[priors."NAME"]``."""

    sd: Number | None = None
    log_sd: Number | None = None
    center: Number | None = None


Range = Annotated[
    list[Number],
    Field(min_length=2, max_length=2),
    otherwise("{} is no range", "Write [lower, upper]."),
]


class LandmarkTable(Part):
    """``[landmarks]``, any of them."""

    hip_centre: Point | None = None
    ankle_centre: Point | None = None
    medial_epicondyle: Point | None = None
    lateral_epicondyle: Point | None = None
    medial_malleolus: Point | None = None
    lateral_malleolus: Point | None = None


_LIGAMENTS, _EFFECTS, _GROUPS, _POSES = (
    otherwise("a list of tables is wanted", f"Write each below a line [[{x}]].")
    for x in ("ligaments", "effects", "groups", "poses")
)


class SubjectTables(Part):
    """The whole of a subject.toml."""

    format: Annotated[
        Literal[1],
        otherwise(
            "format {} is not known",
            f"Write {_EXAMPLES['format']}, or update identknee if the file is newer.",
        ),
    ]
    name: Text
    side: Annotated[
        Literal["right", "left"], otherwise("{} is no side", 'Write "right" or "left".')
    ]
    description: Text = ""
    contact_rounding_mm: Number = 0.0
    surfaces: Annotated[SurfaceFiles, otherwise(_TABLE, "Write it below a line [surfaces].")]
    frames: Annotated[
        FrameTables | None, otherwise(_TABLE, "Write [frames.femur] and [frames.tibia].")
    ] = None
    landmarks: Annotated[
        LandmarkTable | None, otherwise(_TABLE, "Write it below a line [landmarks].")
    ] = None
    ligaments: Annotated[list[Annotated[LigamentTable, _LIGAMENTS]], _LIGAMENTS]
    effects: Annotated[list[Annotated[EffectTable, _EFFECTS]], _EFFECTS] = Field(
        default_factory=list
    )
    groups: Annotated[list[Annotated[GroupTable, _GROUPS]], _GROUPS] = Field(default_factory=list)
    poses: Annotated[list[Annotated[PoseTable, _POSES]], _POSES] = Field(default_factory=list)

    uncertainty: Annotated[
        UncertaintyTable, otherwise(_TABLE, "Write it below a line [uncertainty].")
    ] = Field(default_factory=UncertaintyTable)
    priors: Annotated[
        dict[str, PriorTable],
        otherwise(_TABLE, 'Write each below a line [priors."ACL.stiffness_kN"].'),
    ] = Field(default_factory=dict)
    bounds: Annotated[dict[str, Range], otherwise(_TABLE, "Write them below a line [bounds].")] = (
        Field(default_factory=dict)
    )

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if not self.ligaments:
            raise refusal("ligaments: the list is empty", "Add a table below a line [[ligaments]].")
        if self.frames is None and not self.places:
            raise refusal("the key 'frames' is missing", f"Add {_EXAMPLES['frames']}.")
        return self

    @property
    def places(self) -> Mapping[str, list[float]]:
        """The landmarks given, by name."""
        return {} if self.landmarks is None else self.landmarks.model_dump(exclude_none=True)


def read_tables(path: PathLike) -> SubjectTables:
    """The whole of a subject file, against its schema.

    Raises
    ------
    InputError
        If it cannot be read, is no TOML or breaks the schema: it names the place and the remedy.
    """
    file = Path(path)
    values = read_toml(file)

    def refuse(fault: Fault) -> InputError:
        remedy = remedy_of(SubjectTables, fault, _EXAMPLES)
        key = fault.key if fault.is_unknown else ""
        where = place_of(fault.place, values, key) if fault.place or key else ""
        return InputError(file, where, fault.why, remedy)

    return validated(SubjectTables, values, refuse)


def place_of(place: Place, values: Mapping[str, Any], key: str = "") -> str:
    """A place in a subject file as a person would name it.

    Examples
    --------
    >>> place_of(("frames", "femur", "axes"), {})
    '[frames.femur], key axes'
    >>> place_of(("ligaments", 0, "name"), {"ligaments": [{"name": "ACL"}]})
    'ligament ACL, key name'
    """
    # Positions in a point or in a list of texts are no help.
    steps = list(place)
    while len(steps) > 2 and isinstance(steps[-1], int):
        steps.pop()
    table = ""
    named = ("ligaments", "effects", "groups", "poses")
    if len(steps) > 1 and steps[0] in named and isinstance(steps[1], int):
        own = values[steps[0]][steps[1]]
        name = own.get("name", steps[1] + 1) if isinstance(own, dict) else steps[1] + 1
        table = f"{str(steps[0])[:-1]} {name}"
        steps = steps[2:]
    elif steps and steps[0] in ("frames", "surfaces", "landmarks", "uncertainty", "bounds"):
        is_frame = steps[:1] == ["frames"] and len(steps) > 1 and steps[1] in ("femur", "tibia")
        whole = steps[: 2 if is_frame else 1]
        table = f"[{'.'.join(map(str, whole))}]"
        steps = steps[len(whole) :]
    inner = [str(x + 1) if isinstance(x, int) else str(x) for x in steps]
    if not key and inner:
        key = inner.pop()
    return ", ".join(x for x in (table, *inner, f"key {key}" if key else "") if x)
