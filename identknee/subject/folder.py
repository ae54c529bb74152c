"""Subject folders, subject.toml and the surfaces it names, and the named subjects."""

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, StringConstraints, create_model, model_validator

from identknee.runs.declare import CHECK_UNITS, implausible_coordinates
from identknee.runs.errors import InputError, ValueRefused
from identknee.runs.files import PathLike, prepare_folder, whatever_case, write_atomically
from identknee.runs.progress import progress
from identknee.runs.schema import (
    Fault,
    Number,
    Part,
    Place,
    custom_message,
    plain_value,
    read_toml,
    refusal,
    remedy_of,
    validated,
)
from identknee.runs.words import capitalised
from identknee.subject.capsule import with_capsule
from identknee.subject.check import fatal_geometry_findings
from identknee.subject.examples import known_names, named_subject
from identknee.subject.knee import (
    AXES,
    BONES,
    EffectChoice,
    Frame,
    Knee,
    KnownPose,
    Landmark,
    StatedPrior,
    Uncertainty,
    frames_from_landmarks,
)
from identknee.subject.ligament import Ligament, LigamentGroup, Obstacle
from identknee.subject.menisci import STIFFNESS, with_menisci
from identknee.subject.plausibility import KEY, LIMIT_EXAMPLES, LIMITS, Limit, LimitTable
from identknee.subject.reference import reference_knee
from identknee.subject.surface import Surface, read_surface, surface_of, write_surface

# What messages call it, in place of a file.
NAME = "subject in memory"
INSERTIONS = tuple(f"{bone}_{axis}_mm" for bone in BONES for axis in AXES)
NUMBERS = ("stiffness_kN", "reference_strain_pct")
# Keys that may hold meshes or a data frame, which are not plain values.
_OWN = ("surfaces", "ligaments")
# Remedy for what is not a surface.
FORM = "Give a path, a Surface, a mesh with vertices and faces, or the pair (vertices, faces)."


def taken_apart(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Surface]]:
    """The tables of a subject as its file would have them, and its surfaces by name.

    Parameters
    ----------
    given
        The keys of ``subject.toml``. A surface is a mesh or a path, the ligaments may be a data
        frame, and places may be arrays.

    Raises
    ------
    InputError
        If a surface or the data frame of ligaments cannot be used.
    """
    values = {str(key): plain_value(x) for key, x in given.items() if key not in _OWN}
    surfaces: dict[str, Surface] = {}
    if "surfaces" in given:
        values["surfaces"] = meshes = given["surfaces"]
        if isinstance(meshes, Mapping):
            values["surfaces"] = {str(x): str(x) for x in meshes}
            surfaces = {str(name): _surface(mesh, str(name)) for name, mesh in meshes.items()}
    if "ligaments" in given:
        values["ligaments"] = _ligaments(given["ligaments"])
    return {"format": 1, **values}, surfaces


def _surface(mesh: Any, name: str) -> Surface:
    """The surface that a user gave; arrays are mended as files are."""
    if isinstance(mesh, Surface):
        return mesh
    if isinstance(mesh, str | os.PathLike):
        return read_surface(mesh)
    where = f"surface {name}"
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        pair: tuple[Any, Any] = mesh.vertices, mesh.faces
    elif isinstance(mesh, tuple | list) and len(mesh) == 2:
        pair = mesh[0], mesh[1]
    else:
        raise InputError(NAME, where, f"{type(mesh).__name__} is not a mesh", FORM)
    try:
        vertices, faces = np.asarray(pair[0], float), np.asarray(pair[1])
        return surface_of(vertices, faces)
    except (TypeError, ValueError) as error:
        raise InputError(NAME, where, str(error), FORM) from error


def _ligaments(given: Any) -> Any:
    """Rows of a data frame as tables of ligaments; anything else as it is."""
    if not all(hasattr(given, x) for x in ("columns", "reset_index", "to_dict")):
        return plain_value(given)
    frame = given if "name" in given.columns else given.reset_index(names="name")
    known = ("name", *INSERTIONS, *NUMBERS)
    for column in known:
        if column not in frame.columns:
            raise InputError(
                Path(NAME),
                "ligaments",
                f"the data frame has no column {column}",
                f"Its columns are {', '.join(known)}; the name may be the index.",
            )
    return [
        {
            "name": str(row["name"]),
            **{bone: [float(row[f"{bone}_{x}_mm"]) for x in AXES] for bone in BONES},
            **{x: float(row[x]) for x in NUMBERS},
        }
        for row in frame.to_dict("records")
    ]


FORMAT = 1


def _near(coordinate: float) -> float:
    if far := implausible_coordinates(coordinate):
        raise refusal(f"the point lies {far}", f"{capitalised(CHECK_UNITS)}.")
    return coordinate


Text = Annotated[str, StringConstraints(strip_whitespace=True)]
Point = Annotated[
    list[Annotated[Number, AfterValidator(_near)]],
    Field(min_length=3, max_length=3),
    custom_message("three numbers are wanted, got {}", "Write [x, y, z] with points in mm."),
]
_EXAMPLES = {
    **LIMIT_EXAMPLES,
    "donor_age": "donor_age = 71.0 (years)",
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
    "bone": 'bone = "femur" or bone = "tibia"',
    "centre": "centre = [x, y, z] in mm",
    "radius_mm": "radius_mm = ... (of the cylinder or sphere)",
    "stiffness_kN": "stiffness_kN = ... (kN per unit strain)",
    "reference_strain_pct": "reference_strain_pct = ... (% in the scanned pose)",
}
_TABLE = "{} is not a table"


class SurfaceFiles(Part):
    """``[surfaces]``: the files of the surfaces."""

    femur: Text
    tibia_medial: Text
    tibia_lateral: Text
    femur_bone: Text | None = None
    tibia_bone: Text | None = None

    @model_validator(mode="after")
    def _has_both_bones(self) -> Self:
        if (self.femur_bone is None) != (self.tibia_bone is None):
            raise refusal("one bone is missing", "State femur_bone and tibia_bone, or neither.")
        return self


# Sphinx reads no f-strings in annotations.
_AXES = f"Write {_EXAMPLES['axes']}."


class FrameTable(Part):
    """``[frames.femur]`` or ``[frames.tibia]``."""

    origin: Point
    axes: Annotated[
        list[Point],
        Field(min_length=3, max_length=3),
        custom_message("three rows are wanted", _AXES),
    ]


class FrameTables(Part):
    """``[frames]``."""

    femur: Annotated[FrameTable, custom_message(_TABLE, "Write it below a line [frames.femur].")]
    tibia: Annotated[FrameTable, custom_message(_TABLE, "Write it below a line [frames.tibia].")]


class ObstacleTable(Part):
    """A ``[ligaments.wrap]``: the cylinder or sphere that a ligament wraps around."""

    bone: Literal["femur", "tibia"]
    centre: Point
    radius_mm: Number
    axis: Point | None = None
    side: Point | None = None


class LigamentTable(Part):
    """A ``[[ligaments]]``."""

    name: Text
    femur: Point
    tibia: Point
    stiffness_kN: Number  # noqa: N815 - the unit
    reference_strain_pct: Number
    wrap: Annotated[
        ObstacleTable | None, custom_message(_TABLE, "Write it below a line [ligaments.wrap].")
    ] = None


class LineTable(Part):
    """A line of force of an effect."""

    femur: Point
    tibia: Point


class EffectTable(Part):
    """A ``[[effects]]``."""

    name: Text
    values: Annotated[
        dict[str, Number], custom_message(_TABLE, "Write it below a line [effects.values].")
    ] = Field(default_factory=dict)
    fixed: Annotated[
        list[str], custom_message("{} is not a list of texts", 'Write fixed = ["...", "..."].')
    ] = Field(default_factory=list)
    lines: Annotated[
        list[LineTable],
        Field(min_length=1),
        custom_message("a list of tables is wanted", "Write each below a line [[effects.lines]]."),
    ] = Field(default_factory=list)
    stiffness_sd_kN: Number | None = None  # noqa: N815 - the unit
    site_sd_mm: Number | None = None


Spread = Annotated[
    Number | list[Point],
    custom_message("{} is not a spread", "Write a standard deviation in mm or three rows of mm^2."),
]


class BoneSpreads(Part):
    """How far the two insertions of a ligament may be off."""

    femur: Spread = 0.0
    tibia: Spread = 0.0


class SurfaceSpreads(Part):
    """Of all insertions, along the surface of the bone and across it."""

    tangential: Number
    normal: Number


class GroupTable(Part):
    """A ``[[groups]]``: ligaments whose parameters are tied."""

    name: Text
    members: Annotated[
        list[str], custom_message("{} is not a list of texts", 'Write members = ["...", "..."].')
    ]


class MenisciTable(Part):
    """``[menisci]``, any of it."""

    medial_stiffness_N_per_mm3: Number = STIFFNESS  # noqa: N815 - the unit
    lateral_stiffness_N_per_mm3: Number = STIFFNESS  # noqa: N815 - the unit
    offset_mm: Number = 0.0


class PoseTable(Part):
    """A ``[[poses]]``: where the knee is known to be."""

    flexion_deg: Number
    coordinates: Annotated[
        list[Number],
        Field(min_length=5, max_length=5),
        custom_message(
            "five numbers are wanted, got {}",
            "Write [lateral shift, anterior drawer, distraction, varus, internal] in mm and deg.",
        ),
    ]


_SIZES: dict[str, Any] = {x.name: (Number, 0.0) for x in fields(Uncertainty)}
_Sizes: type[Part] = create_model("_Sizes", __base__=Part, **_SIZES)


class UncertaintyTable(_Sizes):  # type: ignore[valid-type, misc]
    """``[uncertainty]``, any of it."""

    insertions_mm: Annotated[
        Number | SurfaceSpreads | dict[str, BoneSpreads],
        custom_message(
            "{} is not a spread",
            "Write insertions_mm = 2.0, { tangential = 4.0, normal = 1.0 }, or a table by "
            "ligament and bone.",
        ),
    ] = 0.0


class PriorTable(Part):
    """A ``[priors."NAME"]``."""

    sd: Number | None = None
    log_sd: Number | None = None
    center: Number | None = None


Range = Annotated[
    list[Number],
    Field(min_length=2, max_length=2),
    custom_message("{} is not a range", "Write [lower, upper]."),
]


class LandmarkTable(Part):
    """``[landmarks]``, any of them."""

    hip_centre: Point | None = None
    ankle_centre: Point | None = None
    medial_epicondyle: Point | None = None
    lateral_epicondyle: Point | None = None
    medial_malleolus: Point | None = None
    lateral_malleolus: Point | None = None


_OTHER_FORMAT = f"Write {_EXAMPLES['format']}, or update identknee if the file is newer."
_LIGAMENTS, _EFFECTS, _GROUPS, _POSES = (
    custom_message("a list of tables is wanted", f"Write each below a line [[{x}]].")
    for x in ("ligaments", "effects", "groups", "poses")
)


class SubjectTables(Part):
    """The whole of a subject.toml."""

    format: Annotated[
        Literal[1],
        custom_message("format {} is not known", _OTHER_FORMAT),
    ]
    name: Text
    side: Annotated[
        Literal["right", "left"], custom_message("{} is not a side", 'Write "right" or "left".')
    ]
    description: Text = ""
    contact_rounding_mm: Number = 0.0
    surfaces: Annotated[SurfaceFiles, custom_message(_TABLE, "Write it below a line [surfaces].")]
    frames: Annotated[
        FrameTables | None, custom_message(_TABLE, "Write [frames.femur] and [frames.tibia].")
    ] = None
    landmarks: Annotated[
        LandmarkTable | None, custom_message(_TABLE, "Write it below a line [landmarks].")
    ] = None
    ligaments: Annotated[list[Annotated[LigamentTable, _LIGAMENTS]], _LIGAMENTS]
    effects: Annotated[list[Annotated[EffectTable, _EFFECTS]], _EFFECTS] = Field(
        default_factory=list
    )
    groups: Annotated[list[Annotated[GroupTable, _GROUPS]], _GROUPS] = Field(default_factory=list)
    capsule: Annotated[
        list[Text],
        custom_message(
            "{} is not a list of sheets",
            'Write capsule = ["posteromedial", "posterolateral", "anterolateral"], or some.',
        ),
    ] = Field(default_factory=list)
    menisci: Annotated[
        MenisciTable | None, custom_message(_TABLE, "Write it below a line [menisci].")
    ] = None
    poses: Annotated[list[Annotated[PoseTable, _POSES]], _POSES] = Field(default_factory=list)
    plausibility: Annotated[list[Annotated[LimitTable, LIMITS]], LIMITS] = Field(
        default_factory=list
    )
    donor_age: Number | None = None

    uncertainty: Annotated[
        UncertaintyTable, custom_message(_TABLE, "Write it below a line [uncertainty].")
    ] = Field(default_factory=UncertaintyTable)
    priors: Annotated[
        dict[str, PriorTable],
        custom_message(_TABLE, 'Write each below a line [priors."ACL.stiffness_kN"].'),
    ] = Field(default_factory=dict)
    bounds: Annotated[
        dict[str, Range], custom_message(_TABLE, "Write them below a line [bounds].")
    ] = Field(default_factory=dict)

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
        If it cannot be read, is not TOML or breaks the schema: it names the place and the remedy.
    """
    file = Path(path)
    return _tables(read_toml(file), file)


def _tables(values: Mapping[str, Any], file: Path) -> SubjectTables:
    """The tables of a subject against their schema; messages name the file."""

    def refuse(fault: Fault) -> InputError:
        remedy = remedy_of(SubjectTables, fault, _EXAMPLES)
        key = fault.key if fault.is_unknown else ""
        where = place_of(fault.place, values, key) if fault.place or key else ""
        return InputError(file, where, fault.why, remedy)

    return validated(SubjectTables, values, refuse)


def place_of(place: Place, values: Mapping[str, Any], key: str = "") -> str:
    """A place in a subject file, in words.

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


FITTED = "fitted.toml"


def read_fitted(folder: Path) -> dict[str, float]:
    """Values by parameter name of a subject folder; empty where it was not fitted.

    Raises
    ------
    InputError
        If the file cannot be read, or a value is not a finite number in a table of its owner.
    """
    file = folder / FITTED
    if not file.exists():
        return {}
    values: dict[str, float] = {}
    for owner, table in read_toml(file).items():
        for name, value in (table if isinstance(table, dict) else {"": table}).items():
            is_number = isinstance(value, float | int) and abs(value) < float("inf")
            if not name or not is_number:
                raise InputError(
                    file,
                    f"{owner}.{name}".rstrip("."),
                    "a finite number in a table named after a ligament or an effect is wanted",
                    "Write for example [ACL] and below it stiffness_kN = 9.5.",
                )
            values[f"{owner}.{name}"] = float(value)
    return values


def fitted_text(values: Mapping[str, float]) -> str:
    """The text of the file: a table for each owner, also read as ``--start``."""
    lines = [
        "# Where the fit lies: all verbs begin here. Delete this file to begin at subject.toml."
    ]
    tables: dict[str, list[str]] = {}
    for name, value in values.items():
        owner, _, quantity = name.partition(".")
        tables.setdefault(owner, []).append(f"{json.dumps(quantity)} = {float(value)!r}")
    for owner, rows in tables.items():
        lines += ["", f"[{json.dumps(owner, ensure_ascii=False)}]", *rows]
    return "\n".join(lines) + "\n"


FILE = "subject.toml"
SURFACES = ("femur", "tibia_medial", "tibia_lateral")
BONE_SURFACES = ("femur_bone", "tibia_bone")
Made = TypeVar("Made")


def example(name: str) -> Knee:
    """The knee of a named subject, which comes with identknee.

    Parameters
    ----------
    name
        ``"reference"``, ``"lenhart2015"``, ``"lenhart2015_stable"``, ``"s192803"`` or
        ``"s192803_bundles"``; ``identknee subject list`` gives source and licence of each.

    Raises
    ------
    ValueError
        If there is no such subject; the message lists them.

    Examples
    --------
    >>> example("s192803").side
    'left'
    """
    named = named_subject(name)
    if named is None:
        raise ValueError(f"there is no named subject {name!r}. {known_names(str(name))}")
    return reference_knee() if named.file is None else _read(named.file)


def read_subject(path: PathLike | Mapping[str, Any]) -> Knee:
    """The knee of a subject folder, of a named subject such as ``"lenhart2015"``, or from memory.

    Lengths in the files are mm. Every frame there has x anterior, y superior and z to the subject's
    right; a left knee is mirrored, so that the knee returned is always a right one with z lateral.

    Parameters
    ----------
    path
        The folder, its ``subject.toml``, or a name that `example` knows. A name stands for the knee
        that comes with identknee even where a folder is called so: write ``"./lenhart2015"``, or
        give a `pathlib.Path`, for the folder. Or the tables of ``subject.toml`` as a dictionary, in
        which ``surfaces`` are meshes with ``vertices`` and ``faces``, pairs of such arrays or
        paths, and ``ligaments`` may be a pandas ``DataFrame`` with the columns ``name``,
        ``femur_x_mm`` to ``tibia_z_mm``, ``stiffness_kN`` and ``reference_strain_pct``.

    Raises
    ------
    InputError
        If a file is missing or cannot be used: the message names the file, the place in it and the
        remedy. What can be used but looks wrong is left to `check_geometry`.
    """
    if isinstance(path, Mapping):
        values, meshes = taken_apart(path)
        return _knee(_tables(values, Path(NAME)), Path(NAME), meshes, {})
    if isinstance(path, str) and named_subject(path) is not None:
        return example(path)
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.exists() and file.name != FILE:
        remedy = f"{known_names(file.name)} Or give a folder that holds {FILE}."
        if named_subject(str(path)) is not None:
            remedy = f"Give the text {str(path)!r}: a Path is a place on the disk."
        raise InputError(path, "", "there is no such subject folder", remedy)
    if file.name == FILE and not file.exists() and file.parent.is_dir():
        raise InputError(
            file.parent, "", f"the folder holds no {FILE}", "Add one, or give another folder."
        )
    return _read(file)


def write_subject(knee: Knee, folder: PathLike) -> Path:
    """Path of the folder that now holds the knee: ``subject.toml`` and surfaces as binary PLY.

    Parameters at which the knee was fitted stand beside it in ``fitted.toml``.

    Reading it gives the same numbers back; only a closed-form distance is lost. A left knee is
    mirrored back to the side it came from. Nothing is left half-written.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    target = prepare_folder(folder)
    written = knee.mirrored() if knee.side == "left" else knee
    # Of a killed process, `prepare_folder` removes it.
    prefix = f".subject.{os.getpid()}-"
    with tempfile.TemporaryDirectory(prefix=prefix, suffix=".part", dir=target) as staging:
        surfaces = dict(zip(SURFACES, (written.femur, *written.tibia), strict=True))
        if written.bones is not None:
            surfaces |= dict(zip(BONE_SURFACES, written.bones, strict=True))
        names = [f"{name}.ply" for name in surfaces]
        for surface, name in zip(surfaces.values(), names, strict=True):
            write_surface(surface, Path(staging) / name)
        write_atomically(Path(staging) / FILE, _text(written, names))
        files = [*names, FILE]
        if knee.fitted:
            write_atomically(Path(staging) / FITTED, fitted_text(knee.fitted))
            files.append(FITTED)
        else:
            (target / FITTED).unlink(missing_ok=True)
        for name in files:
            (Path(staging) / name).replace(target / name)
    return target


def _surface_file(folder: Path, name: str) -> Path:
    """The file of a surface: also where its name is one of Windows, or in another case."""
    if (folder / name).is_file():
        return folder / name
    parts = [x for x in name.replace("\\", "/").split("/") if x not in ("", ".")]
    return whatever_case(folder, parts) or folder / name


def _read(file: Path) -> Knee:
    tables = read_tables(file)
    named = tables.surfaces.model_dump(exclude_none=True)
    meshes = {
        name: read_surface(_surface_file(file.parent, x))
        for name, x in progress(list(named.items()), description="reading the surfaces")
    }
    return _knee(tables, file, meshes, read_fitted(file.parent) if file.name == FILE else {})


def _knee(
    tables: SubjectTables, file: Path, meshes: Mapping[str, Surface], fitted: Mapping[str, float]
) -> Knee:
    """The knee of these tables and surfaces; messages name the file."""
    landmarks = {x: np.array(position) for x, position in tables.places.items()}
    if tables.frames is None:
        is_left = tables.side == "left"
        frames = _made(file, "[landmarks]", frames_from_landmarks, landmarks, is_left=is_left)
    else:
        femur, tibia = (
            _made(file, f"[frames.{bone}]", Frame, **own.model_dump())
            for bone, own in (("femur", tables.frames.femur), ("tibia", tables.frames.tibia))
        )
        frames = femur, tibia
    surfaces = tuple(meshes[x] for x in SURFACES)
    ligaments = [
        _made(
            file,
            f"ligament {x.name}",
            Ligament,
            **x.model_dump(exclude={"wrap"}),
            wrap=x.wrap
            and _made(file, f"ligament {x.name}, wrap", Obstacle, **x.wrap.model_dump()),
        )
        for x in tables.ligaments
    ]
    effects = [
        _made(
            file,
            f"effect {x.name}",
            EffectChoice,
            **x.model_dump(exclude={"lines"}),
            lines=[(line.femur, line.tibia) for line in x.lines],
        )
        for x in tables.effects
    ]
    groups = [
        _made(file, f"group {x.name}", LigamentGroup, **x.model_dump()) for x in tables.groups
    ]
    bones = None if BONE_SURFACES[0] not in meshes else (meshes["femur_bone"], meshes["tibia_bone"])
    knee = _made(
        file,
        "",
        Knee,
        name=tables.name,
        side=tables.side,
        description=tables.description,
        femur=surfaces[0],
        tibia=surfaces[1:],
        ligaments=ligaments,
        femur_frame=frames[0],
        tibia_frame=frames[1],
        landmarks=[Landmark(name=x, position=position) for x, position in landmarks.items()],
        effects=effects,
        uncertainty=_made(file, "[uncertainty]", Uncertainty, **_stated(tables.uncertainty)),
        priors={
            name: _made(file, f"prior of {name}", StatedPrior, **prior.model_dump())
            for name, prior in tables.priors.items()
        },
        bounds={x: (low, high) for x, (low, high) in tables.bounds.items()},
        groups=groups,
        poses=[KnownPose(**x.model_dump()) for x in tables.poses],
        bones=bones,
        limits=tuple(
            _made(file, f"[[{KEY}]] block {i + 1}", x.limit)
            for i, x in enumerate(tables.plausibility)
        ),
        donor_age=tables.donor_age,
        fitted=fitted,
        contact_rounding_mm=tables.contact_rounding_mm,
    )
    knee = knee.mirrored() if tables.side == "left" else knee
    if tables.capsule:
        extended = _made(file, "key capsule", with_capsule, knee, tables.capsule)
        knee = replace(extended, fitted=fitted)
    if tables.menisci is not None:
        stated = tables.menisci.model_dump()
        knee = replace(_made(file, "[menisci]", with_menisci, knee, **stated), fitted=fitted)
    for finding in fatal_geometry_findings(knee):
        raise InputError(file, finding.where, finding.sentence, finding.remedy)
    return knee


def _stated(table: UncertaintyTable) -> dict[str, Any]:
    """The sizes of an uncertainty, by name."""
    sizes: dict[str, Any] = table.model_dump()
    if isinstance(spreads := table.insertions_mm, SurfaceSpreads):
        sizes |= {"insertions_mm": spreads.tangential, "insertions_normal_mm": spreads.normal}
    return sizes


def _made(file: Path, place: str, make: Callable[..., Made], /, *values: Any, **named: Any) -> Made:
    """`make(values)`; a refused value is an error at this place of the file."""
    try:
        return make(*values, **named)
    except InputError:
        raise
    except ValueError as error:
        why, remedy = str(error), "correct the value"
        if isinstance(error, ValueRefused):
            why, remedy = error.why, error.remedy
        raise InputError(file, place, why, f"{capitalised(remedy)}.") from error


def _text(knee: Knee, surfaces: Iterable[str]) -> str:
    """The subject.toml of a knee whose surfaces are files of these names."""
    lines = [
        "# A subject of identknee. Lengths in mm; frames: x anterior, y superior, z to the right.",
        *_rows(
            format=FORMAT,
            name=knee.name,
            side=knee.side,
            description=knee.description,
            contact_rounding_mm=float(knee.contact_rounding_mm) or None,
            donor_age=knee.donor_age,
        ),
        *("", "[surfaces]", *_rows(**{x.removesuffix(".ply"): x for x in surfaces})),
    ]
    for bone, frame in (("femur", knee.femur_frame), ("tibia", knee.tibia_frame)):
        lines += ["", f"[frames.{bone}]", *_rows(origin=frame.origin, axes=frame.axes)]
    if knee.landmarks:
        lines += ["", "[landmarks]", *_rows(**{x.name: x.position for x in knee.landmarks})]
    lines += [row for ligament in knee.ligaments for row in ("", *_ligament_rows(ligament))]
    if knee.effects:
        lines += ["", "# Amplitudes of effects are those of a right knee, whose z is lateral."]
    for effect in knee.effects:
        lines += ["", "[[effects]]", *_rows(name=effect.name, fixed=list(effect.fixed) or None)]
        for name in ("stiffness_sd_kN", "site_sd_mm"):
            sd = getattr(effect, name)
            lines += _rows(**{name: None if sd is None else float(sd)})
        if effect.values:
            lines += ["[effects.values]", *_rows(**{_toml(k): x for k, x in effect.values.items()})]
        for femur, tibia in effect.lines:
            lines += ["[[effects.lines]]", *_rows(femur=femur, tibia=tibia)]
    stated = {x.name: getattr(knee.uncertainty, x.name) for x in fields(Uncertainty)}
    spreads = stated["insertions_mm"]
    if not knee.uncertainty.is_exact:
        numbers = {name: x for name, x in stated.items() if isinstance(x, float) and x > 0.0}
        lines += ["", "[uncertainty]", *_rows(**numbers)]
    for ligament, bones in () if isinstance(spreads, float) else spreads.items():
        lines += [f"[uncertainty.insertions_mm.{_toml(ligament)}]", *_rows(**bones)]
    for name, prior in knee.priors.items():
        lines += ["", f"[priors.{_toml(name)}]"]
        lines += _rows(sd=prior.sd, log_sd=prior.log_sd, center=prior.center)
    for group in knee.groups:
        lines += ["", "[[groups]]", *_rows(name=group.name, members=list(group.members))]
    lines += [row for limit in knee.limits for row in ("", *_limit_rows(limit))]
    for pose in knee.poses:
        lines += ["", "[[poses]]", *_rows(flexion_deg=float(pose.flexion_deg))]
        lines += _rows(coordinates=pose.coordinates)
    if knee.bounds:
        lines += ["", "[bounds]", *_rows(**{_toml(k): list(x) for k, x in knee.bounds.items()})]
    return "\n".join(lines) + "\n"


def _ligament_rows(ligament: Ligament) -> list[str]:
    x, wrap = ligament, ligament.wrap
    numbers = {"stiffness_kN": float(x.stiffness_kN)}
    numbers["reference_strain_pct"] = float(x.reference_strain_pct)
    rows = ["[[ligaments]]", *_rows(name=x.name, femur=x.femur, tibia=x.tibia, **numbers)]
    if wrap is not None:
        own = {"bone": wrap.bone, "centre": wrap.centre, "radius_mm": float(wrap.radius_mm)}
        rows += ["[ligaments.wrap]", *_rows(**own, axis=wrap.axis, side=wrap.side)]
    return rows


def _limit_rows(limit: Limit) -> list[str]:
    pair = f"{{ mean = {_toml(limit.size)}, sd = {_toml(limit.spread)} }}"
    size = (
        _rows(within=limit.size, scale=limit.spread)
        if limit.form == "within"
        else [f"{limit.form} = {pair}"]
    )
    what = (
        _rows(difference_of=[limit.quantity, limit.less])
        if limit.less
        else _rows(quantity=limit.quantity)
    )
    which = _rows(trials=None if limit.trials == "all" else limit.trials)
    return [f"[[{KEY}]]", *what, *size, *which, *_rows(source=limit.source or None)]


def _rows(**values: Any) -> list[str]:
    """A row of TOML for each value that is there."""
    arrays = {k: x.tolist() if isinstance(x, np.ndarray) else x for k, x in values.items()}
    return [f"{name} = {_toml(x)}" for name, x in arrays.items() if x is not None]


def _toml(value: Any) -> str:
    """Text, numbers and lists as TOML writes them, which is as JSON does."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")
