"""Every array of a result has its unit, found by its name and by what it varies over."""

import numpy as np
import pytest
import xarray

from identknee.report.units import AS_COORDINATE, AS_PARAMETER, AS_QUANTITY, unit, with_units


@pytest.mark.parametrize(
    ("name", "dimensions", "wanted"),
    [
        ("theta", ("chain", "draw", "parameter"), AS_PARAMETER),
        # The log prior density, which ArviZ calls by the name of what it is a density of.
        ("theta", ("chain", "draw"), "1"),
        ("sd", ("trial", "coordinate"), AS_COORDINATE),
        ("lower", ("quantity",), AS_QUANTITY),
        ("lower", ("end", "distance"), "1"),
        ("distance", ("set", "block"), "1"),
        ("margin_N_per_mm", ("trial",), "N/mm"),
        ("internal_moment_Nm", ("candidate",), "N m"),
        ("rhat", ("check", "parameter"), "1"),
    ],
)
def test_a_unit_follows_from_name_and_dimensions(
    name: str, dimensions: tuple[str, ...], wanted: str
) -> None:
    assert unit(name, dimensions) == wanted


def test_numbers_get_units_and_words_do_not() -> None:
    dataset = xarray.Dataset(
        {
            "theta": ("parameter", [1.0, 2.0]),
            "verdict": ("parameter", ["open", "closed"]),
            "own": ("parameter", np.arange(2), {"units": "stones"}),
        },
        coords={"flexion_deg": ("trial", [0.0, 30.0])},
    )
    found = with_units({"group": dataset})["group"]
    assert found["theta"].attrs == {"units": AS_PARAMETER}
    assert found["verdict"].attrs == {}
    assert found["own"].attrs == {"units": "stones"}
    assert found["flexion_deg"].attrs == {"units": "deg"}
    assert dataset["theta"].attrs == {}
