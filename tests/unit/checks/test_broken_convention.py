"""Conventions of a table are looked for before physics, from the table to the terminal."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runs import run
from planted_conventions import PLANTED, clean_table, drawn_table
from slow_cases import some_slow

import identknee as ik
from identknee.checks import broken_convention
from identknee.checks.broken_convention import conventions_of, find_broken_convention
from identknee.checks.data_noise import noise_of
from identknee.checks.table_checks import load_sign_findings
from identknee.laxity.protocol import LOADS, load_protocol
from identknee.laxity.table import COORDINATES, WORKS_ON
from identknee.model.effects.effect import ReadingError, amplitudes
from identknee.model.effects.library import library
from identknee.runs.declare import Array

pytestmark = pytest.mark.usefixtures("few_starts")

# As `drawn_table` takes them in turn.
CAUSES = ("registration", "load_axes", *(x.name for x in library(ik.reference_knee())))


@pytest.fixture(scope="module")
def clean() -> tuple[ik.LaxityModel, ik.Laxity]:
    """The reference knee and a table of one like it."""
    return clean_table("reference", 3)


@pytest.mark.parametrize(
    "name",
    some_slow(
        ["varus_moment_Nm flipped", "angles in radians", "varus_deg in radians", "lengths in cm"],
        ["angles in radians", "varus_deg in radians", "lengths in cm"],
    ),
)
def test_a_broken_convention_is_named(name: str, clean: tuple[ik.LaxityModel, ik.Laxity]) -> None:
    broken = PLANTED[name].broken(clean[1])
    model = clean[0].with_protocol(broken.protocol)
    found = find_broken_convention(model, broken, model.parameters.start)
    assert PLANTED[name].is_named(found)


@pytest.mark.parametrize("is_stated", [True, False])
def test_nothing_is_looked_for_in_a_table_fitted_to_the_noise_it_shows(
    is_stated: bool,
    clean: tuple[ik.LaxityModel, ik.Laxity],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, laxity = clean
    table = laxity if is_stated else replace(laxity, sd=None)
    monkeypatch.delattr(broken_convention, "conventions_of")
    assert find_broken_convention(model, table, model.parameters.start) is None


def test_a_misfit_that_no_convention_removes_is_left_to_physics(
    clean: tuple[ik.LaxityModel, ik.Laxity],
) -> None:
    model, laxity = clean
    moved = np.array(laxity.coordinates)
    moved[:, 4] *= 1.4
    strange = replace(laxity, coordinates=moved)
    assert find_broken_convention(model, strange, model.parameters.start) is None


@pytest.mark.parametrize("stated", some_slow([None, 3.0], [3.0]))
def test_a_misfit_below_the_errors_of_instruments_is_one_beyond_the_noise_of_the_data(
    stated: float | None,
) -> None:
    """1.1 mm at a noise of 0.3 mm, unstated or stated ten times too wide."""
    model, laxity = clean_table("reference", 4, noise=0.3, protocol=load_protocol("seed63"))
    broken = PLANTED["distraction_mm flipped"].broken(laxity)
    sd = None if stated is None else np.full(laxity.coordinates.shape, stated)
    found = find_broken_convention(model, replace(broken, sd=sd), model.parameters.start)
    assert found is not None
    assert found.what == "negating distraction_mm"
    assert found.mm_before < 1.5
    assert found.mm_after == pytest.approx(0.3, rel=0.2)
    assert found.removed > 0.9


def test_without_load_curves_it_takes_what_the_better_fit_leaves_for_noise() -> None:
    drawn = drawn_table("reference", 3, has_curves=False)
    start = drawn.model.parameters.start
    assert noise_of(drawn.laxity, drawn.laxity.coordinates) is None
    assert find_broken_convention(drawn.model, drawn.laxity, start) is None
    planted = PLANTED["varus_deg in radians"]
    found = find_broken_convention(drawn.model, planted.broken(drawn.laxity), start)
    assert planted.is_named(found)


def _divided(laxity: ik.Laxity, column: str, factor: float) -> ik.Laxity:
    """The table with one column in a unit so many times as large, its noise unstated."""
    coordinates, loads = np.array(laxity.coordinates), np.array(laxity.protocol.loads)
    values = coordinates if column in COORDINATES else loads
    values[:, (*COORDINATES, *LOADS).index(column) % 5] /= factor
    protocol = replace(laxity.protocol, loads=loads)
    return replace(laxity, protocol=protocol, coordinates=coordinates, sd=None)


@pytest.mark.parametrize(
    ("column", "unit", "factor"),
    [("anterior_drawer_mm", "inches", 25.4), ("internal_moment_Nm", "kgf·m", 9.80665)],
)
def test_one_column_in_another_unit_is_named(column: str, unit: str, factor: float) -> None:
    model, laxity = clean_table("reference", 4, noise=0.3, protocol=load_protocol("table2"))
    broken = _divided(laxity, column, factor)
    model = model.with_protocol(broken.protocol)
    found = find_broken_convention(model, broken, model.parameters.start)
    assert found is not None
    assert (found.what, found.others) == (f"taking {column} for {unit}", ())
    assert max(found.mm_after, found.deg_after) < 0.35


def test_loads_in_another_unit_are_named_from_where_they_drove_the_fit() -> None:
    # Stiffnesses at their upper bounds: under 45 N·m the subject's own have no equilibrium.
    stuck = np.array([40.0, 40.0, 40.0, 40.0, 15.0, 3.0, 6.0, 7.0])
    model, laxity = clean_table("reference", 4, noise=0.3, protocol=load_protocol("table2"))
    broken = _divided(laxity, "internal_moment_Nm", 0.112985)
    found = find_broken_convention(model.with_protocol(broken.protocol), broken, stuck, stuck)
    assert found is not None
    assert found.what == "taking internal_moment_Nm for inch-pounds"


def test_a_correction_that_leaves_more_than_the_noise_does_not_claim_to_remove_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where no noise is known, what is left counts as misfit: 3 times the noise is not none."""
    model, laxity = clean_table("reference", 4, noise=0.3, protocol=load_protocol("table2"))
    broken = _divided(laxity, "anterior_drawer_mm", 25.4)
    known = [x for x in conventions_of(broken) if "inches" not in x.what]
    monkeypatch.setattr(broken_convention, "conventions_of", lambda *_: known)
    found = find_broken_convention(model, broken, model.parameters.start)
    assert found is None or found.removed < 0.9
    assert found is None or found.mm_after > 0.6


def test_every_unit_is_tried_for_all_columns_of_a_kind_and_for_each() -> None:
    _, laxity = clean_table("reference", 4, noise=0.3, protocol=load_protocol("table2"))
    said = {x.what: np.array(x.factors) for x in conventions_of(laxity)}
    names = (*COORDINATES, *LOADS)
    for kind, unit, factor, columns in (
        ("lengths", "inches", 25.4, COORDINATES[:3]),
        ("angles", "radians", 180.0 / np.pi, COORDINATES[3:]),
        ("moments", "N·mm", 0.001, LOADS[:2]),
        ("moments", "kgf·m", 9.80665, LOADS[:2]),
        ("forces", "kilograms", 9.80665, LOADS[2:]),
    ):
        (whole,) = (x for x in said if x.startswith(f"taking {kind} for {unit} "))
        np.testing.assert_allclose(said[whole], [factor if x in columns else 1.0 for x in names])
        for column in columns:
            own = said[f"taking {column} for {unit}"]
            np.testing.assert_allclose(own, [factor if x == column else 1.0 for x in names])


@pytest.mark.parametrize(
    "cause",
    some_slow(
        ["registration", "load_axes", "anterolateral", "bundles"], ["load_axes", "anterolateral"]
    ),
)
def test_a_table_that_the_model_is_wrong_about_is_not_accused(cause: str) -> None:
    drawn = drawn_table("reference", CAUSES.index(cause), is_wrong=True)
    assert drawn.cause == cause
    assert find_broken_convention(drawn.model, drawn.laxity, drawn.model.parameters.start) is None


def test_what_a_physical_cause_explains_as_well_is_no_convention(
    clean: tuple[ik.LaxityModel, ik.Laxity], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig that reads varus in any proportion explains a sign as well as the convention does."""

    def scaled(coordinates: Array, values: Array, _tests: object) -> Array:
        read = np.array(coordinates)
        read[:, 3] *= 1.0 + values[0]
        return read

    model, laxity = clean
    broken = PLANTED["varus_deg flipped"].broken(laxity)
    for size, is_named in ((0.01, True), (2.0, False)):
        made = amplitudes("rig", ["share"], [size], upper=[4.0 * size])
        rig = ReadingError(name="rig", parameters=made, read=scaled)
        monkeypatch.setattr(broken_convention, "library", lambda *_, rig=rig, **__: (rig,))
        found = find_broken_convention(model, broken, model.parameters.start)
        assert (found is not None) is is_named


def test_rounding_is_no_misfit(clean: tuple[ik.LaxityModel, ik.Laxity]) -> None:
    model = clean[0]
    exact = model.simulate(model.parameters.start)
    rounded = replace(exact, coordinates=np.round(exact.coordinates, 2), sd=None)
    assert find_broken_convention(model, rounded, model.parameters.start) is None


@pytest.mark.slow
def test_fit_and_diagnose_say_it_first(
    clean: tuple[ik.LaxityModel, ik.Laxity], tmp_path: Path
) -> None:
    table = ik.write_laxity(PLANTED["internal_deg flipped"].broken(clean[1]), tmp_path / "x.csv")
    fit = ik.fit("reference", table)
    assert (fit.findings[0].code, fit.findings[0].where) == ("broken-convention", "data")
    assert fit.findings[0].values["what"] == "negating internal_deg"
    assert fit.failure == fit.findings[0].sentence
    shown = run("diagnose", "reference", table, "--out", tmp_path / "out")
    # Nothing holds; the result is written to show why.
    assert shown.exit_code == 1, shown.output
    answer = ik.load(tmp_path / "out")
    assert isinstance(answer, ik.Diagnosis)
    assert answer.verdict is ik.Verdict.NOT_TESTABLE
    assert [x.code for x in answer.findings] == ["broken-convention"]


@pytest.mark.parametrize("load", LOADS[:3])
def test_a_tibia_that_moves_against_its_load_is_seen_in_the_table_alone(
    load: str, clean: tuple[ik.LaxityModel, ik.Laxity]
) -> None:
    laxity = clean[1]
    assert load_sign_findings(laxity) == ()
    k = COORDINATES.index(WORKS_ON[LOADS.index(load)])
    flipped = np.array(laxity.coordinates)
    flipped[:, k] *= -1.0
    (found,) = load_sign_findings(replace(laxity, coordinates=flipped))
    assert found.code == "moves-against-load"
    assert (found.values["coordinate"], found.values["load"]) == (COORDINATES[k], load)


@pytest.mark.slow
@pytest.mark.usefixtures("short_searches")
def test_the_measured_specimen_moves_with_its_loads() -> None:
    laxity = ik.example_laxity("s192803")
    assert load_sign_findings(laxity) == ()
    turned = np.array(laxity.coordinates)
    turned[:, 4] *= -1.0
    answer = ik.fit("s192803", replace(laxity, coordinates=turned), budget=5)
    signs = [x for x in answer.findings if x.code == "moves-against-load"]
    assert [x.values["coordinate"] for x in signs] == ["internal_deg"]
    assert answer.failure


def test_a_change_that_changes_nothing_is_no_candidate() -> None:
    laxity = ik.example_laxity("s192803")
    blank = np.array(laxity.coordinates)
    blank[:, 0] = np.nan
    lacking = replace(laxity, coordinates=blank)
    changes = {x.what: x.applied(lacking) for x in conventions_of(lacking)}
    assert changes["negating lateral_shift_mm"] is None
    assert changes["exchanging lateral_shift_mm and distraction_mm"] is None
    assert changes["taking forces for kN and converting them to N"] is None
    assert changes["negating varus_deg"] is not None


def test_a_deviation_too_small_for_the_unit_is_converted_with_it() -> None:
    laxity = ik.example_laxity("s192803")
    sd = np.full(laxity.coordinates.shape, 0.5)
    sd[:, 3] = 0.5 * np.pi / 180.0
    (angles,) = (x for x in conventions_of(laxity) if x.what.startswith("taking angles for"))
    changed = angles.applied(replace(laxity, coordinates=0.01 * laxity.coordinates, sd=sd))
    assert changed is not None
    assert changed.sd is not None
    np.testing.assert_allclose(changed.sd, 0.5)
