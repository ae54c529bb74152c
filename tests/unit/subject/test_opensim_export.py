"""Knees written as OpenSim models: import gives them back, and all else in a source stays."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from osim_files import write_model

from identknee.runs.errors import InputError
from identknee.subject.folder import example
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament
from identknee.subject.opensim import import_opensim
from identknee.subject.opensim_export import write_opensim
from identknee.subject.reference import reference_knee

ROUNDING = 1e-9  # mm, kN and %; on the way through metres
LIGAMENT_TAGS = {"linear_stiffness", "slack_length", "location"}


@pytest.fixture(scope="module")
def knee() -> Knee:
    return reference_knee(3.0, femur_edge_mm=2.0)


def changed(knee: Knee) -> Knee:
    """The knee with other values in every ligament, the first also with another end."""
    ligaments = [
        replace(x, stiffness_kN=1.5 * x.stiffness_kN, reference_strain_pct=-3.0 + i)
        for i, x in enumerate(knee.ligaments)
    ]
    ligaments[0] = replace(ligaments[0], tibia=ligaments[0].tibia + np.array([1.0, -2.0, 3.0]))
    return knee.with_ligaments(ligaments)


def assert_same_ligaments(found: Knee, knee: Knee) -> None:
    assert [x.name for x in found.ligaments] == [x.name for x in knee.ligaments]
    for one, other in zip(found.ligaments, knee.ligaments, strict=True):
        values = one.stiffness_kN, one.reference_strain_pct, one.length
        wanted = other.stiffness_kN, other.reference_strain_pct, other.length
        np.testing.assert_allclose(values, wanted, atol=ROUNDING)
        for bone, frame in (("femur", "femur_frame"), ("tibia", "tibia_frame")):
            place, as_wanted = (
                getattr(x, frame).to_local(getattr(line, bone))
                for x, line in ((found, one), (knee, other))
            )
            np.testing.assert_allclose(place, as_wanted, atol=ROUNDING)


@pytest.mark.parametrize("name", ["reference", "s192803"])
def test_a_minimal_model_is_the_knee_again(tmp_path: Path, name: str) -> None:
    knee = example(name)
    found = import_opensim(write_opensim(knee, tmp_path))
    assert (found.name, found.side) == (name, knee.side)
    assert_same_ligaments(found, knee)
    between, as_before = (x.femur_frame.axes @ x.tibia_frame.axes.T for x in (found, knee))
    np.testing.assert_allclose(between, as_before, atol=1e-12)
    centre, same = (x.tibia_frame.to_local(x.tibia[0].centroid) for x in (found, knee))
    # Meshes have single precision.
    np.testing.assert_allclose(centre, same, atol=1e-4)


@pytest.mark.parametrize("side", ["r", "l"])
def test_a_source_gets_the_ligaments_and_keeps_the_rest(
    tmp_path: Path, knee: Knee, side: str
) -> None:
    shift, offset = np.array([0.002, -0.003, 0.001]), np.array([0.01, 0.005, 0.0])
    source = write_model(tmp_path, knee, side=side, turn=0.1, shift=shift, offset=offset)
    muscle = "<ForceSet><objects><!--kept--><Muscle name='vasti'><F>7</F></Muscle>"
    source.write_text(source.read_text().replace("<ForceSet><objects>", muscle))
    wanted = changed(import_opensim(source))
    path = write_opensim(wanted, tmp_path / "back", source=source)
    assert_same_ligaments(import_opensim(path), wanted)
    assert "<!--kept-->" in path.read_text()
    before, after = (list(ET.parse(x).getroot().iter()) for x in (source, path))
    different = {x.tag for x, y in zip(before, after, strict=True) if x.text != y.text}
    assert different == LIGAMENT_TAGS
    assert [x.tag for x in before] == [x.tag for x in after]


def test_what_does_not_change_is_not_touched(tmp_path: Path, knee: Knee) -> None:
    source = write_model(tmp_path, knee)
    path = write_opensim(import_opensim(source), tmp_path / "back", source=source)
    before, after = (ET.tostring(ET.parse(x).getroot()) for x in (source, path))
    assert before == after


@pytest.mark.slow
def test_bundles_share_what_their_merged_line_gets(tmp_path: Path) -> None:
    wanted = changed(import_opensim("lenhart2015", bundles="merged"))
    path = write_opensim(wanted, tmp_path, source="lenhart2015")
    assert_same_ligaments(import_opensim(path, bundles="merged"), wanted)
    before, after = (import_opensim(x) for x in ("lenhart2015", path))
    ratios = [
        after.ligament(x).stiffness_kN / before.ligament(x).stiffness_kN
        for x in ("ACLam1", "ACLpl3", "MCLs2", "MCLd1")
    ]
    # The deep bundles of the medial collateral are no part of its line.
    np.testing.assert_allclose(ratios, [1.5, 1.5, 1.5, 1.0])


def test_models_of_something_else_are_refused(tmp_path: Path, knee: Knee) -> None:
    source = write_model(tmp_path, knee)
    own = import_opensim(source)
    with pytest.raises(InputError, match=r"femur.*tibia.*reference"):
        write_opensim(example("reference"), tmp_path / "a", source="lenhart2015")
    other: list[Ligament] = [replace(x, name=f"my {x.name}") for x in own.ligaments]
    with pytest.raises(InputError, match="my ACL"):
        write_opensim(own.with_ligaments(other), tmp_path / "b", source=source)
    with pytest.raises(InputError, match="source itself"):
        write_opensim(replace(own, name="small"), tmp_path, source=source)
    with pytest.raises(InputError, match="no such"):
        write_opensim(own, tmp_path / "c", source=tmp_path / "none.osim")
