"""Numbers with names and units as they are typed."""

from typing import Any

import pytest

from identknee.laxity.noise import noise_sizes
from identknee.verbs.values import bounds_of, values_of


def test_values_come_by_name() -> None:
    assert values_of(["A.x=1", " B.y = -2e1 "]) == {"A.x": 1.0, "B.y": -20.0}


def test_bounds_come_by_name() -> None:
    assert bounds_of(["A.x=-1:2.5"]) == {"A.x": (-1.0, 2.5)}


def test_noise_comes_in_either_order() -> None:
    assert noise_sizes("0.3mm,0.5deg") == noise_sizes("0.5 deg, 0.3 mm") == (0.3, 0.5)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("ACL.stiffness_kN", "NAME=VALUE"),
        ("=3", "NAME=VALUE"),
        ("A.x=stiff", "'stiff'"),
        ("A.x=", "''"),
        ("A.x=nan", "'nan'"),
        ("A.x=inf", "'inf'"),
    ],
)
def test_a_value_that_is_none_is_refused(text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^--set {text}.*") as caught:
        values_of([text])
    assert sentence in str(caught.value)


def test_a_name_given_twice_is_refused() -> None:
    with pytest.raises(ValueError, match=r"--set .*A\.x twice"):
        values_of(["A.x=1", "A.x=2"])
    with pytest.raises(ValueError, match=r"--bounds .*A\.x twice"):
        bounds_of(["A.x=1:2", "A.x=2:3"])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("A.x=3", "LOWER:UPPER"),
        ("A.x=a:3", "'a'"),
        ("A.x", "NAME=VALUE"),
    ],
)
def test_a_bound_that_is_none_is_refused(text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match="--bounds") as caught:
        bounds_of([text])
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "0.3", "0.3mm", "0.3mm,0.3mm", "0.3mm,0.3rad", "mm,deg", "0.3mm;0.3deg", "0.3,0.3"]
)
def test_a_noise_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"--noise 0\.3mm,0\.3deg"):
        noise_sizes(text)


def test_a_size_of_noise_is_a_number() -> None:
    with pytest.raises(ValueError, match="'3e'"):
        noise_sizes("3emm,1deg")


def test_a_stiffness_in_newtons_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ACL\.stiffness_kN.*by 1000"):
        values_of(["ACL.stiffness_kN=9500"])
    assert values_of({"ACL.stiffness_kN": 9.5}) == {"ACL.stiffness_kN": 9.5}


@pytest.mark.parametrize(
    "bounds", [["ACL.stiffness_kN=5e3:15e3"], {"ACL.stiffness_kN": (5e3, 15e3)}]
)
def test_a_lower_bound_in_newtons_is_refused(bounds: Any) -> None:
    with pytest.raises(ValueError, match=r"5000 kN .* divide it by 1000"):
        bounds_of(bounds)
