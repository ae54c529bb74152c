from dataclasses import replace

import numpy as np
import pytest

from identknee.subject.ligament import Ligament

LINE = Ligament(
    name="ACL",
    femur=np.array([0.0, 0.0, 1.0]),
    tibia=np.array([3.0, -4.0, 1.0]),
    stiffness_kN=10.0,
    reference_strain_pct=8.0,
)


def test_length() -> None:
    assert LINE.length == 5.0


def test_mirrored() -> None:
    mirrored = LINE.mirrored()
    assert mirrored.femur.tolist() == [0.0, 0.0, -1.0]
    assert mirrored.length == LINE.length
    assert mirrored.name == "ACL"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": ""}, "name"),
        ({"name": "a.b"}, "rename"),
        ({"name": " a"}, "rename"),
        ({"femur": [0.0, np.nan, 0.0]}, "femur insertion of ACL must be finite"),
        ({"femur": [0.0, 0.0]}, "shape 3"),
        ({"tibia": [0.0, 0.0, 1.0]}, "length zero"),
        ({"stiffness_kN": -1.0}, ">= 0 kN, got -1"),
        ({"stiffness_kN": float("nan")}, "stiffness of ACL"),
        ({"reference_strain_pct": -100.0}, "> -100 %"),
        ({"reference_strain_pct": float("inf")}, "reference strain of ACL"),
    ],
)
def test_refuses(changes: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(LINE, **changes)  # type: ignore[arg-type]
