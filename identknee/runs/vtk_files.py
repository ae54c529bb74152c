"""Lines and triangles as VTK PolyData, which ParaView and PyVista read."""

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import Array, IntArray

TYPES: dict[str, np.dtype[Any]] = {
    "Float32": np.dtype("<f4"),
    "Int32": np.dtype("<i4"),
    "Int64": np.dtype("<i8"),
}


def polydata(
    points: Array,
    lines: IntArray,
    triangles: IntArray,
    values: Mapping[str, ArrayLike],
    words: Mapping[str, Sequence[str]],
) -> bytes:
    """Content of a ``.vtp`` file.

    Parameters
    ----------
    points
        Shape ``(n, 3)``.
    lines, triangles
        Numbers of their points, shapes ``(k, 2)`` and ``(m, 3)``.
    values
        By name a number of each line, then of each triangle, ``(k + m,)``; NaN where it has none.
    words
        By name a list of words about the whole.
    """
    root = ET.Element(
        "VTKFile",
        type="PolyData",
        version="1.0",
        byte_order="LittleEndian",
        header_type="UInt32",
        compressor="vtkZLibDataCompressor",
    )
    whole = ET.SubElement(root, "PolyData")
    fields = ET.SubElement(whole, "FieldData")
    for name, texts in words.items():
        _add_words(fields, name, texts)
    counts = {"NumberOfPoints": len(points), "NumberOfLines": len(lines)}
    counts["NumberOfPolys"] = len(triangles)
    piece = ET.SubElement(whole, "Piece", {name: str(n) for name, n in counts.items()})
    place = ET.SubElement(piece, "Points")
    _add(place, "Points", "Float32", points, NumberOfComponents="3")
    for kind, cells in (("Lines", lines), ("Polys", triangles)):
        held = ET.SubElement(piece, kind)
        _add(held, "connectivity", "Int64", cells)
        _add(held, "offsets", "Int64", cells.shape[1] * np.arange(1, len(cells) + 1))
    cell_data = ET.SubElement(piece, "CellData")
    for name, given in values.items():
        own = np.asarray(given)
        _add(cell_data, name, "Int32" if own.dtype.kind == "i" else "Float32", own)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def collection(files: Sequence[str]) -> bytes:
    """Content of a ``.pvd`` file, which shows others one after the other."""
    root = ET.Element("VTKFile", type="Collection", version="1.0", byte_order="LittleEndian")
    listed = ET.SubElement(root, "Collection")
    for i, file in enumerate(files):
        ET.SubElement(listed, "DataSet", timestep=str(i), part="0", file=file)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _add(parent: ET.Element, name: str, kind: str, values: Array | IntArray, **more: str) -> None:
    """An array as one compressed block in base64, after how large it is before and after."""
    data = np.ascontiguousarray(values, TYPES[kind]).tobytes()
    block = zlib.compress(data)
    sizes = np.array([1, len(data), len(data), len(block)], "<u4").tobytes()
    told = {"type": kind, "Name": name, "format": "binary", **more}
    element = ET.SubElement(parent, "DataArray", told)
    element.text = (base64.b64encode(sizes) + base64.b64encode(block)).decode("ascii")


def _add_words(parent: ET.Element, name: str, words: Sequence[str]) -> None:
    """Words as the numbers of their bytes, each ended by a zero."""
    element = ET.SubElement(
        parent,
        "DataArray",
        type="String",
        Name=name,
        NumberOfTuples=str(len(words)),
        format="ascii",
    )
    element.text = " ".join(str(x) for word in words for x in (*word.encode("utf-8"), 0))
