"""Effects on the subject's own ligaments: the same as other knees in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol
from tolerances import SAME_POSE

from identknee.laxity.protocol import Protocol, load_protocol
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model import laxity_model as joint
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.subject.anatomy import anatomy
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament


@pytest.fixture
def small(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> Knee:
    monkeypatch.setattr(joint, "cache_folder", lambda: tmp_path)
    return small_knee(names=("a", "b", "c", "d"))


def with_effect(knee: Knee, name: str, protocol: Protocol | None = None) -> LaxityModel:
    return LaxityModel(
        knee=knee, protocol=protocol or small_protocol(), effects=(effect_named(knee, name),)
    )


def test_bundles_are_two_ligaments_of_half_the_stiffness(small: Knee) -> None:
    model = with_effect(small, "bundles")
    m, n = len(small.ligaments), model.n_ligament_parameters
    rng = np.random.default_rng(5)
    strains, places = rng.uniform(2.0, 6.0, m), rng.uniform(-1.5, 1.5, (m, 2, 3))
    theta = np.r_[model.parameters.center[:n], strains, places.ravel()]
    assert [x.rpartition("_")[2] for x in model.parameters.names[n:]] == m * ["pct"] + 6 * m * [
        "mm"
    ]

    def bundle(k: int, sign: float) -> Ligament:
        ligament, aside = small.ligaments[k], 0.5 * sign * places[k]
        return replace(
            ligament,
            name=f"{ligament.name}{sign:+g}",
            stiffness_kN=0.5 * ligament.stiffness_kN,
            reference_strain_pct=ligament.reference_strain_pct + 0.5 * sign * strains[k],
            femur=ligament.femur + aside[0] @ small.femur_frame.axes,
            tibia=ligament.tibia + aside[1] @ small.tibia_frame.axes,
        )

    split = small.with_ligaments([bundle(k, s) for s in (1.0, -1.0) for k in range(m)])
    other = LaxityModel(knee=split, protocol=small_protocol())
    found = model.predict(theta, derivatives=False)
    wanted = other.predict(other.parameters.center, derivatives=False)
    assert np.abs(found.coordinates - wanted.coordinates).max() <= SAME_POSE
    forces = tensions_of(other, wanted)
    np.testing.assert_allclose(tensions_of(model, found), forces[:, :m] + forces[:, m:], rtol=1e-6)


def test_shifted_insertions_are_another_knee(small: Knee) -> None:
    model = with_effect(small, "insertion")
    rng = np.random.default_rng(4)
    shifts = rng.uniform(-0.8, 0.8, (len(small.ligaments), 2, 3))
    n = model.n_ligament_parameters
    theta = np.r_[model.parameters.center[:n], shifts.ravel()]
    moved = small.with_ligaments(
        [
            replace(
                x,
                femur=x.femur + shift[0] @ small.femur_frame.axes,
                tibia=x.tibia + shift[1] @ small.tibia_frame.axes,
            )
            for x, shift in zip(small.ligaments, shifts, strict=True)
        ]
    )
    other = LaxityModel(knee=moved, protocol=small_protocol())
    wanted = other.predict(other.parameters.center, derivatives=False).coordinates
    found = model.predict(theta, derivatives=False).coordinates
    assert np.abs(found - wanted)[~np.isnan(wanted)].max() <= SAME_POSE


def test_the_lift_is_medial_at_the_joint_line(reference: Knee) -> None:
    model = with_effect(reference, "mcl_wrapping", load_protocol("seed63").select([0]))
    lift = 6.0
    setting = model.setting(model.parameters.vector({"mcl_wrapping.lift_mm": lift}))
    name = anatomy(reference).medial_collateral
    ligament = reference.ligament(name or "")
    index = [x.name for x in reference.ligaments].index(ligament.name)
    line = ligament.femur - ligament.tibia
    height = anatomy(reference).joint_line
    # In the scanned pose of this knee both frames are those of the scanner.
    share = (height - ligament.tibia[1]) / line[1]
    corner = ligament.tibia + share * line + [0.0, 0.0, -lift]
    way = np.linalg.norm(ligament.femur - corner) + np.linalg.norm(ligament.tibia - corner)
    assert setting.lines.reference_length[index] == pytest.approx(way, rel=1e-12)
    assert way > ligament.length + 0.1
    others = np.arange(len(reference.ligaments)) != index
    np.testing.assert_array_equal(
        setting.lines.reference_length[others], reference.reference_lengths[others]
    )
    lengths = line_lengths(setting.lines, model.joint.start_flexion, model.joint.start)
    np.testing.assert_allclose(lengths, setting.lines.reference_length, rtol=1e-12)


def test_a_longer_toe_gives_way_further(reference: Knee) -> None:
    protocol = load_protocol("seed63")
    model = with_effect(reference, "toe_strain", protocol)
    stiff, soft = (
        model.predict(
            model.parameters.vector({"toe_strain.transition_strain_pct": x}), derivatives=False
        ).coordinates
        for x in (-1.0, 1.0)
    )
    axes = {4: "internal_moment_Nm", 3: "varus_moment_Nm"}
    for column, load in axes.items():
        sign = np.sign(protocol.loads[:, ["internal_moment_Nm", "varus_moment_Nm"].index(load)])
        assert (sign * (soft - stiff)[:, column]).sum() > 0.0
    setting = model.setting(model.parameters.vector({"toe_strain.transition_strain_pct": 1.0}))
    np.testing.assert_allclose(setting.lines.transition, 0.04)
