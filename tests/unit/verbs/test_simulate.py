"""`simulate`: parameters by name, outcomes in sentences."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_knee import small_knee

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import read_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.errors import InputError
from identknee.subject.knee import KnownPose
from identknee.subject.reference import reference_knee
from identknee.verbs.simulate import simulate
from identknee.verbs.values import by_ligament


def test_it_is_the_models_own_prediction() -> None:
    knee, protocol = reference_knee(), load_protocol("drawer")
    simulation = simulate(knee, protocol, {"ACL.stiffness_kN": 9.0})
    model = LaxityModel(knee=knee, protocol=protocol)
    theta = np.r_[9.0, model.parameters.center[1:]]
    np.testing.assert_array_equal(simulation.theta, theta)
    np.testing.assert_array_equal(simulation.laxity.coordinates, model.simulate(theta).coordinates)


def test_every_trial_has_its_reason() -> None:
    protocol = load_protocol("drawer")
    slack = {f"{name}.stiffness_kN": 0.0 for name in ("ACL", "PCL", "LCL", "MCL")}
    simulation = simulate(reference_knee(), protocol, slack)
    assert simulation.n_converged == 0
    assert len(simulation.trials) == protocol.n
    assert all(re.search(r"\d % of ", x.reason) for x in simulation.trials)
    assert all(x.reason for x in simulate(reference_knee(), protocol).trials)


def test_another_labs_trials_without_values_are_predicted_from_the_poses_of_the_knee(
    tmp_path: Path,
) -> None:
    table = tmp_path / "its.csv"
    table.write_text(
        "trial;flexion_deg;external_moment_Nm;compression_force_N\n"
        "P1;6,5;-0,3;5\nP2;9;0,2;5\nfar;31;0;5\n",
        encoding="utf-8",
    )
    plain, trials = small_knee(), read_laxity(table, is_measured=False).protocol
    model = LaxityModel(knee=plain, protocol=trials)
    at = model.simulate(model.parameters.start).coordinates[0]
    poses = [KnownPose(flexion_deg=x, coordinates=at) for x in (5.0, 10.0)]
    found = simulate(replace(plain, poses=tuple(poses)), str(table))
    assert trials.loads[:, 0].tolist() == [0.3, -0.2, 0.0]
    np.testing.assert_allclose(found.coordinates[:2], model.simulate(found.theta).coordinates[:2])
    assert found.rmse is None
    assert "5 to 10 deg" in found.assumptions[-1]
    assert "(far)" in found.assumptions[-1]
    with pytest.raises(InputError, match="column holds"):
        read_laxity(table)


def test_the_trials_of_a_table_that_comes_with_identknee_go_by_its_name() -> None:
    answer = simulate("s192803", "s192803")
    assert answer.rmse is not None
    assert [x.trial for x in answer.trials] == list(read_laxity("s192803").protocol.trials)


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'ACL\.stiffness'"):
        simulate(reference_knee(), load_protocol("drawer"), {"ACL.stiffness": 9.0})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"continuation": "jump"}, "continuation jump: it is none of continuation, single-step"),
        ({"contact": "soft"}, "contact soft: it is none of field, mesh"),
        ({"noise": (0.3,)}, "these are not two sizes"),
    ],
)
def test_wrong_words_from_python_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        simulate("reference", "drawer", **options)


def test_parameters_are_split_at_the_last_dot() -> None:
    assert by_ligament({"a.b.k": 1.0, "a.b.e": 2.0, "c.k": 3.0}) == {
        "a.b": {"k": 1.0, "e": 2.0},
        "c": {"k": 3.0},
    }
