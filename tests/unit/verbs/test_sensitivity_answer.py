"""The answer of a sensitivity analysis: what it holds, and that files give it back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_folders import write_given

from identknee.identify.sensitivity import FAILURE, Box, Sensitivity
from identknee.identify.sensitivity_estimators import Index
from identknee.laxity.trial_words import LaxityGroup
from identknee.model.parameters import ligament_parameters
from identknee.report.printer import terminal_lines
from identknee.runs.findings import finding
from identknee.runs.schema import summary_of, to_plain
from identknee.verbs.files import groups_of, load
from identknee.verbs.sensitivity import GlobalSensitivity

PARAMETERS = ligament_parameters(["A", "new"], [1.0, 2.0], [3.0, 4.0])
GROUP = LaxityGroup(coordinate="varus_deg", flexion_deg=0.0, load="unloaded")
GROUPS = (GROUP.name, FAILURE)


def index(*, floor: bool = False) -> Index:
    values = np.random.default_rng(0).random((3, 2, 4))
    return Index(
        levels=np.array([2, 4, 8]),
        values=values,
        half_widths=0.1 * values,
        complete=values[-1],
        complete_half_widths=0.2 * values[-1],
        noise_floor=np.array([0.1, 0.2]) if floor else None,
    )


def answer(*, is_box: bool, share: float = 0.2) -> GlobalSensitivity:
    analysis = Sensitivity(
        method="sobol" if is_box else "delta",
        parameters=PARAMETERS,
        groups=GROUPS,
        indices={"S1": index(), "ST": index()} if is_box else {"delta": index(floor=True)},
        failed_share=np.array([0.1, share]),
        complete_share=np.array([0.8, 0.7]),
        component_share=np.ones(2),
        n_samples=8,
        n_simulations=48,
        box=Box(lower=np.zeros(4), upper=np.ones(4)) if is_box else None,
        seed=3,
    )
    return GlobalSensitivity(analysis=analysis, laxity_groups=(GROUP,))


@pytest.mark.parametrize("is_box", [True, False])
def test_files_give_the_answer_back(is_box: bool, tmp_path: Path) -> None:
    made = answer(is_box=is_box)
    write_given(tmp_path, "sensitivity", made)
    again = load(tmp_path)
    assert isinstance(again, GlobalSensitivity)
    one, other = (to_plain(x) | {"record": None} for x in (made, again))
    assert json.dumps(one) == json.dumps(other)
    assert terminal_lines(again) == terminal_lines(made)


def test_the_dataset_holds_every_index_by_name() -> None:
    made = answer(is_box=True)
    data = groups_of(made)["sensitivity"]
    assert data["half_width_by_level"].dims == ("index", "level", "group", "parameter")
    assert data["n_samples"].sel(index="ST").values.tolist() == [2, 4, 8]
    one = data["index_by_level"].sel(index="ST", group=FAILURE, parameter="new.stiffness_kN")[-1]
    assert one.item() == made.analysis.indices["ST"].final[1, 1]
    assert summary_of(made)["box"]["upper"] == [1.0] * 4
    given = answer(is_box=False)
    assert summary_of(given)["box"] is None
    assert groups_of(given)["sensitivity"]["noise_floor"].values.tolist() == [[0.1, 0.2]]


def test_the_summary_names_the_largest_index() -> None:
    made = answer(is_box=True)
    said = summary_of(made)["indices"]["ST"]["new.stiffness_kN"]
    assert said["largest"] == {
        "value": made.analysis.indices["ST"].final[0, 1],
        "group": GROUPS[0],
    }
    assert "varus angulation" in terminal_lines(made)[0]
    # Results of earlier versions have the name of the group alone.
    assert GROUP.name in terminal_lines(replace(made, laxity_groups=()))[0]


def test_nothing_without_failure_is_said(tmp_path: Path) -> None:
    assert answer(is_box=True).failure == ""
    lost = replace(answer(is_box=True), findings=(finding("no-set-converges", "trials"),))
    assert lost.failure == lost.findings[0].sentence
