import csv

import numpy as np
import pytest
from common.published import TABLE2, TABLE5, table2_laxity

from identknee.laxity.named_tables import FOLDER
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import COORDINATES, Laxity


def printed_rows(name: str) -> list[dict[str, str]]:
    with (FOLDER / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_table2_is_as_printed() -> None:
    measured = [row for row in printed_rows("literature_laxity.csv") if row["id"].startswith("S")]
    models = printed_rows("paper_model_laxity.csv")
    for row, printed, model in zip(TABLE2, measured, models, strict=True):
        assert row.study == printed["study"]
        assert row.load == printed["load_type"] == model["load_type"]
        assert row.quantity == printed["quantity"]
        assert row.unit == printed["unit"]
        numbers = [row.magnitude, row.flexion_deg, row.mean, row.sd, row.paper_model]
        texts = [printed[x] for x in ("load_value", "flexion_deg", "mean", "sd")]
        assert numbers == [float(x) for x in [*texts, model["model_value"]]]


def test_table5_is_as_printed() -> None:
    def pair(row: dict[str, str], name: str, unit: str) -> tuple[float, float] | None:
        mean, sd = row[f"{name}_rmse_{unit}"], row[f"{name}_sd"]
        return (float(mean), float(sd)) if mean else None

    printed = printed_rows("simulation_vs_experiment_rmse.csv")
    studies = [row for row in TABLE5 if not row.study.startswith("the paper")]
    for row, other in zip(studies, printed, strict=True):
        assert row.study.split()[0] == other["study"].split()[0]
        assert row.flexion_deg == (float(other["flexion_deg"]) if other["flexion_deg"] else None)
        assert row.internal_deg == pair(other, "rotation_internal", "deg")
        assert row.varus_deg == pair(other, "rotation_varus", "deg")
        assert row.anterior_mm == pair(other, "anterior_translation", "mm")


def test_table2_and_its_protocol_have_the_same_trials() -> None:
    protocol = load_protocol("table2")
    loaded = {t for t, idle in zip(protocol.trials, protocol.is_unloaded, strict=True) if not idle}
    assert {row.trial for row in TABLE2} == loaded
    for row in TABLE2:
        index = protocol.trials.index(row.trial)
        assert protocol.flexion_deg[index] == row.flexion_deg
        assert tuple(protocol.loads[index]) == row.loads


def test_responses_are_positive_the_way_the_load_pushes() -> None:
    protocol = load_protocol("table2")
    coordinates = np.full((protocol.n, 5), 50.0)
    for row in TABLE2:
        index = protocol.trials.index(row.trial)
        coordinates[index, COORDINATES.index(row.coordinate)] += row.sign * row.mean
    laxity = Laxity(protocol=protocol, coordinates=coordinates)
    # Adding and taking away 50 rounds at its own last digit.
    np.testing.assert_allclose(
        table2_laxity(laxity), [row.mean for row in TABLE2], rtol=0, atol=50 * 2.3e-16
    )
    posterior = TABLE2[1]
    assert (posterior.column, posterior.value) == ("anterior_force_N", -100)


def test_a_missing_trial_is_named() -> None:
    drawer = load_protocol("drawer")
    laxity = Laxity(protocol=drawer, coordinates=np.zeros((drawer.n, 5)))
    with pytest.raises(ValueError, match=r"no trial with internal moment 5 at 30 deg\. Simulate"):
        table2_laxity(laxity)
