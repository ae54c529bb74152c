"""A table that does not define its translations: said where it matters, and how much."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.checks.ambiguous_translations import CLEAR_RISE
from identknee.checks.left_out_trials import trials_asked
from identknee.laxity.table import Laxity, read_laxity, write_laxity
from identknee.laxity.translations import to_components
from identknee.runs.findings import Finding, Severity

CODE = "translations-ambiguous"


@pytest.fixture(scope="module")
def measured() -> Laxity:
    """Of the reference knee, in which lengths hang on the definition by up to 0.36 mm."""
    made = ik.simulate("reference", "table2").laxity
    return replace(made, sd=np.where(made.is_measured, 0.1, np.nan))


def found(findings: tuple[Finding, ...]) -> list[Finding]:
    return [x for x in findings if x.code == CODE]


def unstated(laxity: Laxity, path: Path) -> Path:
    """The table without the line that defines its translations."""
    write_laxity(replace(laxity, is_definition_stated=False), path)
    return path


def largest_change(laxity: Laxity) -> float:
    other = to_components("projections", laxity.protocol.flexion_deg, laxity.coordinates)
    return float(np.abs(other - laxity.coordinates).max())


def test_a_table_may_define_its_translations(measured: Laxity, tmp_path: Path) -> None:
    text = write_laxity(measured, tmp_path / "a.csv").read_text(encoding="utf-8")
    (tmp_path / "a.csv").write_text(f"# translations: components\n{text}", encoding="utf-8")
    assert read_laxity(tmp_path / "a.csv").is_definition_stated
    assert not found(trials_asked(read_laxity(tmp_path / "a.csv")).findings)
    again = read_laxity(unstated(measured, tmp_path / "b.csv"))
    assert not again.is_definition_stated
    assert not again.select([0, 1]).is_definition_stated


def test_said_of_the_table_alone_beyond_the_noise_only(measured: Laxity, tmp_path: Path) -> None:
    table = read_laxity(unstated(measured, tmp_path / "a.csv"))
    one = found(trials_asked(table).findings)[0]
    assert one.values["change_mm"] == pytest.approx(largest_change(measured), rel=1e-9)
    assert one.values["trial"] in measured.protocol.trials
    assert not found(trials_asked(table, noise_mm=10.0).findings)
    assert measured.sd is not None
    assert not found(trials_asked(replace(table, sd=100.0 * measured.sd)).findings)


def test_fit_says_what_the_other_reading_gives(measured: Laxity, tmp_path: Path) -> None:
    """A fit to the table read otherwise finds the parameters that the finding names."""
    path = unstated(measured, tmp_path / "a.csv")
    (said,) = found(ik.fit("reference", path, noise="0.1mm,0.1deg", more_starts=0).findings)
    other = tmp_path / "other.csv"
    other.write_text("# translations: projections\n" + path.read_text("utf-8"), encoding="utf-8")
    refitted = ik.fit("reference", other, noise="0.1mm,0.1deg", more_starts=0)
    assert not found(refitted.findings)
    fitted = dict(zip(refitted.parameter_names, refitted.theta, strict=True))
    for name, value in said.values["parameters"]["projections"].items():
        assert value == pytest.approx(fitted[name], rel=1e-3)
    rise = said.values["rise"]["projections"]
    assert rise > 0.0
    # Where the data exclude the other reading there is nothing to warn of.
    assert (said.severity is Severity.INFO) == (rise > CLEAR_RISE)


def test_other_verbs_do_not_pass_it_over(measured: Laxity, tmp_path: Path) -> None:
    path = unstated(measured, tmp_path / "a.csv")
    answer = ik.sweep("reference", path, noise="0.1mm,0.1deg", n_starts=1, paths=0)
    assert len(found(answer.findings)) == 1
