"""The study of what a cut is worth: its simulated knees, their plans, and what it compares."""

from types import ModuleType

import numpy as np
import pytest
from common.records import study_knee
from study_modules import STUDIES, study_module

import identknee as ik
from identknee.model.parameter_groups import tied
from identknee.subject.knee import Uncertainty

FOLDER = STUDIES / "16_what_a_cut_is_worth"


def load(name: str) -> ModuleType:
    return study_module(FOLDER / f"{name}.py")


def test_eighteen_ligaments_have_all_bundles_of_the_model_once() -> None:
    knee, bundles = load("slack_lengths").eighteen_ligaments(), study_knee("lenhart2015_bundles")
    assert tied(knee).n == 18
    total = sum(x.stiffness_kN for x in bundles.ligaments)
    assert sum(x.stiffness_kN for x in knee.ligaments) == pytest.approx(total)
    own = {x.name: x for x in knee.ligaments}
    mean = np.mean([x.femur for x in bundles.ligaments if x.name.startswith("ACLpl")], axis=0)
    np.testing.assert_allclose(own["ACLpl"].femur, mean)


def test_a_slack_length_follows_strain_and_insertions() -> None:
    module = load("slack_lengths")
    # The frames of its bones are turned against the image.
    knee = ik.example("s192803").with_uncertainty(Uncertainty(insertions_mm=2.0))
    model = ik.LaxityModel(knee=knee, protocol=ik.load_protocol("drawer"))
    theta, names = np.array(model.parameters.start), list(model.parameters.names)
    here, k = module.slack_lengths(model, theta), model.tied.names.index("PCL")
    line = next(x for x in knee.ligaments if x.name == "PCL")
    length = np.linalg.norm(line.femur - line.tibia)
    strain = theta[names.index("PCL.reference_strain_pct")]
    assert strain != 0.0
    assert here[k] == pytest.approx(length / (1.0 + 0.01 * strain))
    # Away from the other end it is longer by as much.
    along = knee.femur_frame.axes @ (line.femur - line.tibia) / length
    for axis, part in zip("xyz", along, strict=True):
        theta[names.index(f"insertion.PCL_femur_{axis}_mm")] += 2.0 * part
    moved = module.slack_lengths(model, theta)
    assert moved[k] == pytest.approx((length + 2.0) / (1.0 + 0.01 * strain))
    np.testing.assert_array_equal(np.delete(moved, k), np.delete(here, k))


def test_passes_are_mounted_anew_and_forces_stay_with_their_own() -> None:
    module = load("laboratory")
    table = module.measured_table().select([0, 1, 2, 3])
    parts = [
        module.one_pass(table.protocol, k, (state,) * 4)
        for k, state in ((1, "intact"), (2, "cut: ACL"))
    ]
    laxities = [
        ik.Laxity(protocol=x, coordinates=table.coordinates, sd=np.ones((4, 5))) for x in parts
    ]
    forces = module.measured_forces({"ACL.tension_N": np.arange(4.0)}, 5.0)
    joined = module.joined(
        [
            laxities[0],
            ik.Laxity(
                protocol=parts[1], coordinates=table.coordinates, sd=np.ones((4, 5)), forces=forces
            ),
        ]
    )
    assert joined.protocol.mounting.tolist() == [0] * 4 + [1] * 4
    assert joined.protocol.state == ("intact",) * 4 + ("cut: ACL",) * 4
    assert joined.forces is not None
    assert np.isnan(joined.forces.values[:4]).all()
    assert joined.forces.values[4:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert np.unique(joined.protocol.flexion_deg).size == joined.n


def test_the_tested_knee_has_the_insertions_and_parameters_that_a_fit_found() -> None:
    module = load("laboratory")
    theta = {
        "ACL.stiffness_kN": 12.5,
        "insertion.MCL_tibia_x_mm": 3.0,
        "insertion.MCL_tibia_y_mm": 4.0,
    }
    knee, own = module.simulated_knee(theta, {"insertions_mm": 2.0}), ik.example("s192803")
    before, after = ({x.name: x for x in k.ligaments} for k in (own, knee))
    assert after["ACL"].stiffness_kN == 12.5
    assert np.linalg.norm(after["MCL"].tibia - before["MCL"].tibia) == pytest.approx(5.0)
    np.testing.assert_array_equal(after["MCL"].femur, before["MCL"].femur)
    assert knee.uncertainty.insertions_mm == 2.0
    assert knee.uncertainty.registration_mm == 4.0
    halved = module.halved(knee, "insertion.LCL_femur")
    sizes = [np.sqrt(halved.insertion_covariance("LCL", x)[0, 0]) for x in ("femur", "tibia")]
    assert sizes == [2.0, 4.0]


def test_a_narrowing_counts_intervals_that_are_closed_before_and_after() -> None:
    module = load("figures")
    before = {"a": [0.0, 4.0], "b": [1.0, 2.0], "c": [1.0, None], "d": [None, 2.0]}
    after = {"a": [1.0, 2.0], "b": [1.0, 2.0], "c": [1.0, 2.0], "d": [None, 1.0]}
    percent, n = module.narrowed(before, after)
    assert n == 2
    assert percent == pytest.approx(50.0)


def test_errors_of_forces_count_by_how_many_there_are() -> None:
    module = load("figures")
    found = [{"n": 3, "rms": 1.0}, {"n": 1, "rms": 3.0}]
    assert module.mean_square_root(found, "rms") == pytest.approx(np.sqrt(3.0))
