"""Effects of a subject as plain data: what is refused, and the way through a subject folder."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posed_knees import posed_reference

from identknee.runs.errors import InputError
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import EffectChoice, Knee, Side
from identknee.subject.reference import reference_knee

LINE = (np.array([1.0, 2.0, 3.0]), np.array([4.0, -5.0, 6.0]))


def choices() -> tuple[EffectChoice, ...]:
    return (
        EffectChoice(
            name="some line",
            values={"stiffness_kN": 0.1 + 0.2, "femur_x_mm": -1.0},
            fixed=("femur_x_mm",),
            lines=(LINE, (LINE[1], LINE[0])),
            stiffness_sd_kN=1.5,
            site_sd_mm=0.0,
        ),
        EffectChoice(name="bundles", values={'odd "name"_pct': 3.0}),
        EffectChoice(name="plain"),
    )


def assert_same(one: tuple[EffectChoice, ...], other: tuple[EffectChoice, ...]) -> None:
    for a, b in zip(one, other, strict=True):
        assert (a.name, dict(a.values), a.fixed) == (b.name, dict(b.values), b.fixed)
        assert (a.stiffness_sd_kN, a.site_sd_mm) == (b.stiffness_sd_kN, b.site_sd_mm)
        np.testing.assert_array_equal(np.array(a.lines), np.array(b.lines))


@pytest.mark.parametrize("side", ["left", "right"])
def test_effects_come_back(tmp_path: Path, side: Side) -> None:
    knee = posed_reference(4, side=side, edge_mm=3.0).with_effects(choices())
    read = read_subject(write_subject(knee, tmp_path))
    assert_same(read.effects, knee.effects)
    assert read.side == side


def test_a_left_folder_holds_mirrored_lines_and_the_same_amplitudes(tmp_path: Path) -> None:
    knee = posed_reference(4, side="left", edge_mm=3.0).with_effects(choices())
    text = (write_subject(knee, tmp_path) / "subject.toml").read_text(encoding="utf-8")
    assert "femur = [1.0, 2.0, -3.0]" in text
    assert '"femur_x_mm" = -1.0' in text
    assert_same(knee.mirrored().mirrored().effects, knee.effects)


def test_a_choice_cannot_be_changed() -> None:
    values = {"force_N": 1.0}
    choice = EffectChoice(name="compression", values=values)
    values["force_N"] = 2.0
    assert choice.values["force_N"] == 1.0
    assert not EffectChoice(name="x", lines=(LINE,)).lines[0][0].flags.writeable


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: EffectChoice(name="x", values={"a": np.nan}), "x.a must be finite"),
        (lambda: EffectChoice(name="x", fixed=("a",)), "x.a is fixed but has no value"),
        (lambda: EffectChoice(name="x", stiffness_sd_kN=0.0), "greater than 0"),
        (lambda: EffectChoice(name="x", site_sd_mm=-1.0), "0 or greater"),
        (lambda: EffectChoice(name="x", lines=((LINE[0], LINE[0]),)), "has length zero"),
    ],
    ids=["not finite", "fixed", "stiffness_sd", "site_sd", "no length"],
)
def test_what_makes_no_sense_is_refused(make: Callable[[], EffectChoice], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_two_effects_of_one_name_are_refused(reference: Knee) -> None:
    one = EffectChoice(name="drift")
    with pytest.raises(ValueError, match="two ligaments or effects are called drift"):
        reference.with_effects([one, one])


@pytest.mark.parametrize(
    ("block", "where"),
    [
        ("values = {a = 1.0}", "the key 'name' is missing"),
        ('name = "x"\nvalue = 3.0', "there is no key 'value'"),
        ('name = "x"\nvalues = {a = "1"}', "effect x, values, key a"),
        ('name = "x"\nvalues = 3', "is not a table"),
        ('name = "x"\nfixed = "a"', "is not a list of texts"),
        ('name = "x"\nfixed = ["a"]', "x.a is fixed but has no value"),
        ('name = "x"\nsite_sd_mm = "1"', "key site_sd_mm"),
        ('name = "x"\nlines = [{femur = [1, 2, 3]}]', "the key 'tibia' is missing"),
        ('name = "x"\nlines = [{femur = [1, 2], tibia = [1, 2, 3]}]', "three numbers are wanted"),
    ],
)
def test_a_file_that_is_wrong_is_told_where(tmp_path: Path, block: str, where: str) -> None:
    knee = replace(reference_knee(3.0, femur_edge_mm=2.0), name="mine")
    file = write_subject(knee, tmp_path) / "subject.toml"
    file.write_text(f"{file.read_text(encoding='utf-8')}\n[[effects]]\n{block}\n", encoding="utf-8")
    with pytest.raises(InputError, match=where) as caught:
        read_subject(tmp_path)
    assert "\n" not in str(caught.value)
