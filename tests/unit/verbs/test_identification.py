"""The set-up of the verbs of identifiability: noise stated or estimated, and what is said of it."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identknee.laxity.table import Laxity, add_noise, read_laxity, write_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.errors import NotComputable
from identknee.runs.executors import serial
from identknee.runs.findings import Severity
from identknee.subject.reference import reference_knee
from identknee.verbs.identification import Identification, best_fits, identification


@pytest.fixture(scope="module")
def measured(reference_model: LaxityModel) -> Laxity:
    """The reference knee measured with an error of 0.2 mm and 0.4 deg, which the file states."""
    simulated = reference_model.simulate(reference_model.parameters.center)
    return add_noise(simulated, sd_mm=0.2, sd_deg=0.4, seed=3)


def written(laxity: Laxity, folder: Path) -> Path:
    path = folder / "laxity.csv"
    write_laxity(laxity, path)
    return path


def identified(path: Path, **options: Any) -> Identification:
    """The set-up of the reference knee and a table."""
    return identification(reference_knee(), read_laxity(path), **options)


def test_stated_noise_gives_residuals_of_variance_one(measured: Laxity, tmp_path: Path) -> None:
    setup = identified(written(measured, tmp_path))
    residuals = setup.problem.residuals(setup.problem.parameters.center)
    # The mean square of 315 standard normal residuals has sd sqrt(2 / 315); 4 of them.
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 315))
    assert setup.degrees_of_freedom is None
    assert setup.assumptions == (setup.knee.uncertainty.sentence,)


def test_unstated_noise_is_estimated_and_said(measured: Laxity, tmp_path: Path) -> None:
    setup = identified(written(replace(measured, sd=None), tmp_path))
    assert setup.degrees_of_freedom == 315 - 8
    _, sentence = setup.assumptions
    assert "no noise" in sentence
    residuals = setup.problem.residuals(setup.problem.parameters.center)
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 315))


def test_noise_on_the_command_line_replaces_that_of_the_file(
    measured: Laxity, tmp_path: Path
) -> None:
    setup = identified(written(measured, tmp_path), noise="0.4mm,0.8deg")
    assert setup.laxity.sd is not None
    np.testing.assert_array_equal(setup.laxity.sd[0], [0.4, 0.4, 0.4, 0.8, 0.8])


def test_fixed_parameters_keep_their_value(measured: Laxity, tmp_path: Path) -> None:
    setup = identified(written(measured, tmp_path), fixed=["PCL.stiffness_kN"])
    names = setup.model.parameters.names
    assert setup.problem.parameters.names == tuple(n for n in names if n != "PCL.stiffness_kN")
    several = np.arange(14.0).reshape(2, 7)
    whole = setup.free.expand(several)
    kept = setup.model.parameters.index("PCL.stiffness_kN")
    np.testing.assert_array_equal(whole[:, kept], setup.free.fixed_values[kept])
    np.testing.assert_array_equal(np.delete(whole, kept, axis=1), several)


def test_blank_columns_and_few_values_are_said(measured: Laxity, tmp_path: Path) -> None:
    coordinates = np.full_like(measured.coordinates, np.nan)
    coordinates[:5, 1] = measured.coordinates[:5, 1]
    few = replace(measured, coordinates=coordinates)
    setup = identified(written(few, tmp_path))
    said = " ".join(setup.assumptions)
    assert "varus_deg was" in said
    assert re.search(r"\b5 .*\b8 parameters", said)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"noise": "0mm,0.5deg"}, "both must be more than 0"),
        ({"noise": "0.5"}, "this is not a size of noise"),
        ({"fixed": ["ACL.stifness_kN"]}, "there is no parameter 'ACL.stifness_kN'"),
    ],
)
def test_wrong_options_are_refused(
    measured: Laxity, tmp_path: Path, change: dict[str, str], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        identified(written(measured, tmp_path), **change)


def test_data_without_a_value_are_refused(measured: Laxity, tmp_path: Path) -> None:
    blank = replace(measured, coordinates=np.full_like(measured.coordinates, np.nan), sd=None)
    with pytest.raises(ValueError, match="no coordinate"):
        identified(written(blank, tmp_path))


def test_noise_stated_of_some_coordinates_only_is_refused(measured: Laxity, tmp_path: Path) -> None:
    path = written(measured, tmp_path)
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    column = rows[0].index("sd_varus_deg")
    kept = [",".join(row[:column] + row[column + 1 :]) for row in rows]
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"sd_varus_deg.*--noise"):
        identified(path)
    stated = identified(path, noise="0.2mm,0.4deg")
    assert stated.assumptions == (stated.knee.uncertainty.sentence,)


def test_a_misfit_beyond_the_noise_is_said(measured: Laxity, tmp_path: Path) -> None:
    setup = identified(written(measured, tmp_path))
    # 315 values, 8 parameters: noise leaves 307, with a standard deviation of 25.
    assert setup.findings_at(setup.start, 307.0) == ()
    # One in twenty data sets leaves more than 349, one in a thousand more than 388.
    for deviance in (352.0, 614.0):
        (found,) = setup.findings_at(setup.start, deviance)
        assert (found.code, found.severity) == ("conditional-on-misfit", Severity.WARNING)
        assert found.where == "data"
        assert found.values["deviance"] == deviance


@pytest.mark.slow
def test_an_estimated_noise_that_no_instrument_has_is_said(
    measured: Laxity, tmp_path: Path
) -> None:
    mirrored = measured.coordinates * [1.0, 1.0, 1.0, 1.0, -1.0]
    wrong = replace(measured, coordinates=mirrored, sd=None)
    setup = identified(written(wrong, tmp_path))
    assert setup.estimated_noise[1] is not None
    flipped, found = setup.findings_at(setup.problem.parameters.center, 307.0)
    assert flipped.code == "broken-convention"
    assert flipped.values["what"] == "negating internal_deg"
    assert (found.code, found.severity) == ("error-large", Severity.ERROR)


def test_a_parameter_held_is_no_choice(measured: Laxity, tmp_path: Path) -> None:
    setup = identified(written(measured, tmp_path), fixed=["ACL.stiffness_kN"])
    assert setup.free_index("PCL.stiffness_kN", "--pair") == 0
    with pytest.raises(ValueError, match=r"--pair.*ACL\.stiffness_kN.*--fix"):
        setup.free_index("ACL.stiffness_kN", "--pair")


def test_no_prediction_names_the_trials(measured: Laxity, tmp_path: Path) -> None:
    slack = "\n".join(f"[{x}]\nreference_strain_pct = -15.0" for x in ("ACL", "PCL", "LCL", "MCL"))
    start = tmp_path / "slack.toml"
    start.write_text(slack, encoding="utf-8")
    bounds = [f"{x}.reference_strain_pct=-15:-14.9" for x in ("ACL", "PCL", "LCL", "MCL")]
    setup = identified(written(measured, tmp_path), start=str(start), bounds=bounds)
    with pytest.raises(NotComputable, match=r"63 of 63 .*flexion0_"):
        best_fits(setup, seed=0, executor=serial)


def test_noise_to_be_estimated_without_a_prediction_is_no_mistake_of_the_input(
    measured: Laxity, tmp_path: Path
) -> None:
    slack = "\n".join(f"[{x}]\nreference_strain_pct = -15.0" for x in ("ACL", "PCL", "LCL", "MCL"))
    start = tmp_path / "slack.toml"
    start.write_text(slack, encoding="utf-8")
    silent = written(replace(measured, sd=None), tmp_path)
    bounds = [f"{x}.reference_strain_pct=-15:-14.9" for x in ("ACL", "PCL", "LCL", "MCL")]
    with pytest.raises(NotComputable, match=r"63 of 63 .*flexion0_"):
        identified(silent, start=str(start), bounds=bounds)


def test_a_start_outside_the_bounds_is_refused(measured: Laxity, tmp_path: Path) -> None:
    bounds = ["ACL.stiffness_kN=20:30"]
    setup = identified(written(measured, tmp_path), bounds=bounds)
    with pytest.raises(ValueError, match=r"ACL\.stiffness_kN.*10.*20.*30"):
        best_fits(setup, seed=0, executor=serial)
