"""The two files every verb leaves: a flat summary for people and checks, and all arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray

from identknee.report.units import with_units
from identknee.runs.errors import InputError
from identknee.runs.files import digest, part_beside, write_atomically, write_json
from identknee.runs.record import Record

SUMMARY = "result.json"
ARRAYS = "result.nc"


def write_result(
    folder: Path,
    summary: Mapping[str, Any],
    groups: Mapping[str, xarray.Dataset],
    record: Record,
) -> dict[str, Any]:
    """The summary with its record, as now written to `result.json`; `result.nc` has the arrays.

    Parameters
    ----------
    folder
        An existing folder; older files of these names are replaced whole.
    summary
        What `result.json` holds beside the record, in JSON types and arrays.
    groups
        Datasets by group name: ``constant_data``, ``observed_data``, ``predictions`` and others.
        They become the groups of an xarray DataTree, read with ``xarray.open_datatree``; arrays
        get their ``units``.
    record
        The call, its inputs, seed and versions; kept in both files.

    Raises
    ------
    InputError
        If a file cannot be written; neither is left half-written.
    """
    # The summary comes last: where it stands the arrays stand too.
    content = _write_arrays(folder / ARRAYS, groups, record)
    whole = {**summary, "record": {**record.to_dict(), "arrays": digest(content)}}
    write_json(folder / SUMMARY, whole)
    return whole


def _write_arrays(path: Path, groups: Mapping[str, xarray.Dataset], record: Record) -> bytes:
    """The bytes now written."""
    tree = xarray.DataTree.from_dict(with_units(groups))
    tree.attrs = {
        "verb": record.verb,
        "started": record.started,
        "versions": ", ".join(f"{name} {version}" for name, version in record.versions.items()),
    }
    # The library writes to paths only; its file becomes bytes that are written whole or not at all.
    temporary = part_beside(path)
    try:
        tree.to_netcdf(temporary, engine="h5netcdf")
        content = temporary.read_bytes()
    except OSError as error:
        remedy = "Free some space or choose another folder with --out."
        raise InputError(path, "", f"it cannot be written ({error})", remedy) from error
    finally:
        temporary.unlink(missing_ok=True)
    write_atomically(path, content)
    return content
