"""A subject in memory: the tables of subject.toml, with meshes and a data frame of ligaments."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from identknee.runs.errors import InputError
from identknee.runs.schema import plain_value
from identknee.subject.knee import AXES, BONES
from identknee.subject.surface import Surface, read_surface, surface_of

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
