"""Definitions of translations against another library, round trips, and files that state them."""

from dataclasses import replace
from pathlib import Path

import grood_suntay
import numpy as np
import pytest

import identknee as ik
from identknee.laxity.table import Laxity, read_laxity, relative_to_unloaded, write_laxity
from identknee.laxity.translations import (
    DEFINITIONS,
    Translations,
    from_components,
    sd_of_components,
    to_components,
)
from identknee.mechanics.pose import coordinates_from_pose, rotation_matrix
from identknee.runs.declare import Array
from identknee.runs.errors import InputError

# Round trips of lengths of 20 mm in double precision.
ROUNDING = 1e-9


def poses(n: int = 40) -> tuple[Array, Array, Array]:
    """Flexion [deg], rotation matrices of the tibia and its origin in femoral axes [mm]."""
    generator = np.random.default_rng(3)
    flexion = generator.uniform(-5.0, 120.0, n)
    varus, internal = generator.uniform(-12.0, 12.0, n), generator.uniform(-30.0, 30.0, n)
    angles = np.radians([flexion, varus, internal])
    rotation = np.moveaxis(rotation_matrix(*angles), -1, 0)
    return flexion, rotation, generator.normal(scale=20.0, size=(n, 3))


def coordinates_of(flexion: Array, rotation: Array, origin: Array) -> Array:
    """Components of the poses, as the model has them."""
    turned = np.moveaxis(rotation_matrix(np.radians(flexion), *np.zeros((2, flexion.size))), -1, 0)
    varus = np.arcsin(rotation[:, 2, 1])
    internal = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    xyz = np.einsum("nji,nj->ni", turned, origin)
    return np.asarray(coordinates_from_pose(np.column_stack([varus, internal, xyz])))


def test_projections_and_angles_are_those_of_another_library() -> None:
    flexion, rotation, origin = poses()
    own = coordinates_of(flexion, rotation, origin)
    femur_in_tibia = np.zeros((flexion.size, 4, 4))
    femur_in_tibia[:, :3, :3] = np.swapaxes(rotation, 1, 2)
    femur_in_tibia[:, :3, 3] = -np.einsum("nji,nj->ni", rotation, origin)
    femur_in_tibia[:, 3, 3] = 1.0
    peer = grood_suntay.calculate(femur_in_tibia)
    np.testing.assert_allclose(peer.flexion_extension_deg, flexion, atol=ROUNDING)
    np.testing.assert_allclose(-peer.ab_adduction_deg, own[:, 3], atol=ROUNDING)
    np.testing.assert_allclose(-peer.internal_external_rotation_deg, own[:, 4], atol=ROUNDING)
    found = from_components("projections", flexion, own)
    theirs = [-peer.medial_lateral, -peer.anterior_posterior, peer.proximal_distal]
    np.testing.assert_allclose(found[:, :3], np.transpose(theirs), atol=ROUNDING)
    lateral, anterior, superior = np.transpose(peer.joint_basis_translation)[[2, 0, 1]]
    np.testing.assert_allclose(own[:, :3], np.transpose([-lateral, -anterior, superior]), atol=1e-9)


def test_translations_along_the_axes_of_a_bone_are_those_of_the_vector() -> None:
    flexion, rotation, origin = poses()
    own = coordinates_of(flexion, rotation, origin)
    in_tibia = np.einsum("nji,nj->ni", rotation, origin)
    vectors: dict[Translations, Array] = {"femur": origin, "tibia": in_tibia}
    for definition, vector in vectors.items():
        expected = np.column_stack([vector[:, 2], vector[:, 0], -vector[:, 1]])
        found = from_components(definition, flexion, own)
        np.testing.assert_allclose(found[:, :3], expected, atol=ROUNDING)
        np.testing.assert_array_equal(found[:, 3:], own[:, 3:])


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_there_and_back_is_the_same(definition: Translations) -> None:
    flexion, rotation, origin = poses()
    own = coordinates_of(flexion, rotation, origin)
    there = from_components(definition, flexion, own)
    np.testing.assert_allclose(to_components(definition, flexion, there), own, atol=ROUNDING)


def test_how_far_definitions_are_apart() -> None:
    """20 mm of distraction and 8 deg of varus: 2.8 mm of lateral shift."""
    own = np.array([[0.0, 0.0, 20.0, 8.0, 0.0]])
    found = from_components("projections", np.zeros(1), own)
    assert found[0, 0] == pytest.approx(-20.0 * np.sin(np.radians(8.0)), abs=1e-12)
    assert found[0, 2] == pytest.approx(20.0, abs=1e-12)


def test_standard_deviations_follow() -> None:
    """Those of many draws of the errors."""
    flexion, rotation, origin = poses(1)
    own = coordinates_of(flexion, rotation, origin)
    sd = np.array([[0.5, 1.0, 2.0, 0.3, 0.4]])
    n = 20_000
    noise = np.random.default_rng(0).normal(size=(n, 3)) * sd[0, :3]
    for definition in DEFINITIONS:
        there = np.repeat(from_components(definition, flexion, own), n, axis=0)
        there[:, :3] += noise
        drawn = to_components(definition, np.repeat(flexion, n), there).std(axis=0)
        found = sd_of_components(definition, flexion, there[:1] * 0.0 + own, sd)
        # A standard deviation of n draws is known to 1 / sqrt(2 n) of it.
        np.testing.assert_allclose(found[0, :3], drawn[:3], rtol=4.0 / np.sqrt(2.0 * n))
        np.testing.assert_array_equal(found[0, 3:], sd[0, 3:])


@pytest.fixture
def laxity() -> Laxity:
    """The reference knee under nine trials, with noise."""
    made = ik.simulate(ik.reference_knee(), "drawer").laxity
    return ik.add_noise(made, sd_mm=0.3, sd_deg=0.4, seed=2)


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_files_state_their_definition(
    definition: Translations, laxity: Laxity, tmp_path: Path
) -> None:
    path = write_laxity(laxity, tmp_path / "a.csv", translations=definition)
    back = read_laxity(path)
    np.testing.assert_allclose(back.coordinates, laxity.coordinates, atol=ROUNDING)
    assert back.sd is not None
    assert laxity.sd is not None
    np.testing.assert_array_equal(back.sd[:, 3:], laxity.sd[:, 3:])
    text = path.read_text(encoding="utf-8")
    unread = tmp_path / "b.csv"
    unread.write_text(text.replace(f"# translations: {definition}\n", ""), encoding="utf-8")
    apart = np.abs(read_laxity(unread).coordinates - laxity.coordinates).max()
    assert (apart < ROUNDING) == (definition == "components")


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_a_table_of_so_many_decimals_is_the_same_to_the_last_bit(
    definition: Translations, tmp_path: Path
) -> None:
    """On this knee rounding errors of 4e-15 mm led fits to other minima."""
    measured = read_laxity("s192803")
    path = write_laxity(measured, tmp_path / "a.csv", translations=definition)
    np.testing.assert_array_equal(read_laxity(path).coordinates, measured.coordinates)


def test_what_a_component_hangs_on_must_be_there(laxity: Laxity, tmp_path: Path) -> None:
    for column, refused in ((3, True), (2, True), (1, False)):
        coordinates = np.array(laxity.coordinates)
        coordinates[4, column] = np.nan
        path = write_laxity(replace(laxity, coordinates=coordinates, sd=None), tmp_path / "a.csv")
        lines = path.read_text(encoding="utf-8")
        path.write_text(f"# translations: projections\n{lines}", encoding="utf-8")
        if refused:
            with pytest.raises(InputError, match=laxity.protocol.trials[4]):
                read_laxity(path)
        else:
            known = ~np.isnan(read_laxity(path).coordinates)
            np.testing.assert_array_equal(known, ~np.isnan(coordinates))


def test_words_that_are_no_definition_are_refused(laxity: Laxity, tmp_path: Path) -> None:
    lines = write_laxity(laxity, tmp_path / "a.csv").read_text(encoding="utf-8")
    for said, why in (
        ("# translations: oblique", "row 1: 'oblique'.*projections"),
        ("# translations: femur\n# zero: unloaded", "row 1: .*absolute"),
        ("# translations = projections", "row 1: .*Write: # translations: projections"),
        ("# translation: tibia", "row 1: .*Write: # translations: tibia"),
        ("# translations as projections", "row 1: .*Write: # translations: projections"),
        ("# Zero = unloaded", "row 1: .*Write: # zero: unloaded"),
        ("# within_trial_corelation: 0.5", "row 1: .*Write: # within_trial_correlation: 0.5"),
    ):
        (tmp_path / "b.csv").write_text(f"{said}\n{lines}", encoding="utf-8")
        with pytest.raises(InputError, match=why):
            read_laxity(tmp_path / "b.csv")
    changes = relative_to_unloaded(laxity)
    with pytest.raises(ValueError, match="absolute"):
        write_laxity(changes, tmp_path / "c.csv", translations="femur")


@pytest.mark.parametrize(
    "free", ["translations in mm", "zero load at first", "Zone: 3", "made = 4"]
)
def test_comments_that_state_nothing_are_kept(laxity: Laxity, tmp_path: Path, free: str) -> None:
    lines = write_laxity(laxity, tmp_path / "a.csv").read_text(encoding="utf-8")
    (tmp_path / "b.csv").write_text(f"# {free}\n{lines}", encoding="utf-8")
    assert free in read_laxity(tmp_path / "b.csv").comments
