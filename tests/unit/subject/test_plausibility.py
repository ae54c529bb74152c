"""Limits of plausibility: read, written, by default, and refused."""

from dataclasses import replace
from pathlib import Path

import pytest

import identknee as ik
from identknee.runs.errors import InputError, ValueRefused
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Uncertainty
from identknee.subject.plausibility import (
    OTHER_NAMES,
    Limit,
    acl_strength,
    default_limits,
    read_limits,
)

FILE = """
[[plausibility]]
quantity = "MCL.tension_N"
strength = { mean = 557.0, sd = 160.0 }
source = "Wijdicks 2010"
[[plausibility]]
difference_of = ["contact.medial_N", "contact.lateral_N"]
trials = "no varus moment"
within = 150.0
scale = 75.0
[[plausibility]]
quantity = "ACL.tension_N@134 N anterior, 30 deg"
normal = { mean = 110.0, sd = 30.0 }
"""


def test_a_file_of_limits_is_read(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(FILE)
    strength, balance, standard = read_limits(path)
    assert (strength.form, strength.what, strength.size, strength.spread) == (
        "strength",
        "MCL.tension_N",
        557.0,
        160.0,
    )
    assert (balance.form, balance.what, balance.less, balance.trials) == (
        "within",
        "contact.medial_N",
        "contact.lateral_N",
        "no varus moment",
    )
    assert (standard.form, standard.load) == ("normal", "134 N anterior, 30 deg")
    knee = ik.reference_knee().with_plausibility(path)
    assert knee.plausibility == (strength, balance, standard)
    assert knee.with_plausibility("none").plausibility == ()
    assert knee.with_plausibility(None).plausibility == knee.plausibility


def test_limits_of_a_subject_are_kept_and_count_where_asked(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(FILE)
    knee = replace(ik.reference_knee(), limits=read_limits(path), donor_age=71.0)
    again = read_subject(write_subject(knee, tmp_path / "knee"))
    assert again.limits == knee.limits
    assert again.donor_age == 71.0
    assert again.plausibility == ()
    assert again.with_plausibility("default").plausibility == knee.limits


def test_the_usual_limits_are_of_the_ligaments_that_a_knee_has() -> None:
    names = ["ACLam", "ACLpl", "LCL", "POL", "ALS"]
    found = {x.name: x for x in default_limits(names, donor_age=71.0)}
    assert found["ACL.tension_N"].size == 658.0
    assert {"LCL.tension_N", "POL.tension_N"} < set(found)
    assert not {"MCL.tension_N", "ALS.tension_N"} & set(found)
    assert {"ACL.strain_pct", "LCL.strain_pct", "POL.strain_pct", "ALS.strain_pct"} < set(found)
    assert sum(x.form == "within" for x in found.values()) == 2
    assert all(x.source for x in found.values())


def test_the_strength_of_the_acl_falls_with_age() -> None:
    assert acl_strength(25.0) == (2160.0, 157.0)
    assert acl_strength(45.0) == (1503.0, 83.0)
    assert acl_strength(80.0) == (658.0, 129.0)
    # Of any age: mean of the three, and the spread within and between them.
    mean, sd = acl_strength(None)
    means, sds = (2160.0, 1503.0, 658.0), (157.0, 83.0, 129.0)
    variance = (
        sum(s**2 + m**2 for s, m in zip(sds, means, strict=True)) / 3.0 - (sum(means) / 3) ** 2
    )
    assert mean == pytest.approx(sum(means) / 3.0, abs=1.0)
    assert sd == pytest.approx(variance**0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("sd = 160.0", "sd = 0.0", "[[plausibility]] block 1"),
        ("MCL.tension_N", "MCL.length_mm", "[[plausibility]] block 1"),
        ("scale = 75.0", "", "[[plausibility]] block 2"),
        ('"contact.lateral_N"]', '"ACL.tension_N"]', "[[plausibility]] block 2"),
        ("no varus moment", "some", "[[plausibility]] block 2"),
        ("@134 N anterior, 30 deg", "", "[[plausibility]] block 3"),
        ("within = 150.0", "within = 150.0\nwidth = 2.0", "[[plausibility]] block 2"),
    ],
)
def test_a_limit_that_says_nothing_is_refused_by_its_place(
    old: str, new: str, place: str, tmp_path: Path
) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(FILE.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_limits(path)
    assert caught.value.where == place
    assert caught.value.remedy


@pytest.mark.parametrize("asked", ["believable", [1.0]])
def test_no_limits_are_found_under_another_name(asked: object) -> None:
    with pytest.raises(ValueRefused):
        ik.reference_knee().with_plausibility(asked)  # type: ignore[arg-type]


def test_the_entry_that_is_not_a_limit_is_named() -> None:
    limit = default_limits(["MCL"])[0]
    with pytest.raises(ValueRefused, match=r"\bfloat\b"):
        ik.reference_knee().with_plausibility([limit, 1.0])  # type: ignore[list-item]


@pytest.mark.parametrize("age", [0.0, -3.0, 150.0, float("nan")])
def test_an_age_that_no_donor_has_is_refused(age: float) -> None:
    with pytest.raises(ValueRefused):
        replace(ik.reference_knee(), donor_age=age)


def test_a_name_says_what_is_limited_and_where() -> None:
    limit = Limit(
        form="within",
        quantity="contact.medial_N",
        less="contact.lateral_N",
        size=1.0,
        spread=1.0,
        trials="nearly unloaded",
    )
    assert limit.name == "contact.medial_N - contact.lateral_N, nearly unloaded"
    assert limit.unit == "N"


def test_limits_of_structures_count_where_the_knee_has_them() -> None:
    knee = ik.reference_knee().with_plausibility("default")
    assert "deep_mcl.tension_N" in {x.name for x in knee.plausibility}
    assert not {x.owner for x in knee.counted_limits} & {*OTHER_NAMES}
    unknown = knee.with_uncertainty(Uncertainty(structures=1.0))
    assert unknown.counted_limits == knee.plausibility
