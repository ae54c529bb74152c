"""Trials that the others contradict: leave-one-out residuals, and what answers say of them."""

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planted_conventions import NOISE, clean_table
from scipy.sparse import csr_array
from tolerances import CLOSED_FORM

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.checks.table_checks import (
    contradicted_rows,
    end_point_findings,
    leave_one_out,
    row_findings,
    suspicious_end_points,
    suspicious_rows,
)
from identknee.diagnosis.investigation import investigate
from identknee.laxity.protocol import concatenate
from identknee.runs.declare import Array
from identknee.subject.capsule import with_capsule

pytestmark = pytest.mark.usefixtures("few_starts")


def test_a_value_left_out_is_one_predicted_by_a_fit_without_it() -> None:
    generator = np.random.default_rng(0)
    design, noise = generator.standard_normal((30, 4)), generator.standard_normal(30)
    sd = np.where(np.arange(30) % 2, 2.0, 0.5)
    measured = design @ [1.0, 2.0, 3.0, 4.0] + sd * noise
    measured[7] += 40.0
    found = leave_one_out(measured / sd, design / sd[:, None], np.diag(1.0 / sd))
    (row,) = suspicious_rows(found, np.arange(30), np.zeros(30, int))
    others = np.delete(np.arange(30), 7)
    weights = 1.0 / sd[others]
    rest = np.linalg.lstsq(
        design[others] * weights[:, None], measured[others] * weights, rcond=None
    )
    assert row.trial == 7
    assert row.off[0] == pytest.approx(measured[7] - design[7] @ rest[0], rel=1e-9)
    covariance = np.linalg.inv((design[others] * weights[:, None] ** 2).T @ design[others])
    scale = float(rest[1][0]) / 25
    variance = scale * (sd[7] ** 2 + design[7] @ covariance @ design[7])
    assert row.errors[0] == pytest.approx(np.sqrt(variance), rel=1e-9)


def blocks(n: int, seed: int) -> tuple[Array, Array, Any]:
    """Residuals of n trials of five values, their derivatives, and columns a block a trial."""
    generator = np.random.default_rng(seed)
    errors = np.eye(5) + 0.2 * generator.standard_normal((n, 5, 5))
    trials = np.repeat(np.arange(n), 5)
    rows = (np.arange(5 * n)[:, None] + np.zeros(5, int)).ravel()
    columns = (5 * trials[:, None] + np.arange(5)).ravel()
    return (
        generator.standard_normal(5 * n),
        generator.standard_normal((5 * n, 4)),
        csr_array((errors.reshape(-1), (rows, columns))),
    )


def test_the_sparse_form_is_the_dense_one() -> None:
    left, design, columns = blocks(12, 6)
    found = leave_one_out(left, design, columns)
    basis = np.linalg.qr(design)[0]
    free = columns.toarray() - basis @ (basis.T @ columns.toarray())
    products = found.own.toarray() - found.explained.T @ found.explained
    np.testing.assert_allclose(products, free.T @ free, atol=CLOSED_FORM)
    np.testing.assert_allclose(found.sizes, np.diag(free.T @ free), atol=CLOSED_FORM)
    np.testing.assert_allclose(found.left, free.T @ left, atol=CLOSED_FORM)
    # The square that is left where these columns are parameters, too.
    own = np.arange(20, 25)
    (fall,) = found.falls(own[None], np.ones((1, 5), bool))
    rest = np.linalg.lstsq(np.hstack([design, columns.toarray()[:, own]]), left, rcond=None)[1]
    assert found.square - fall == pytest.approx(rest[0], rel=CLOSED_FORM)
    without = found.without(own)
    assert without.square == pytest.approx(rest[0], rel=CLOSED_FORM)
    np.testing.assert_allclose(without.sizes[own], 0.0, atol=CLOSED_FORM)
    np.testing.assert_allclose(without.left[own], 0.0, atol=CLOSED_FORM)


def test_four_times_the_trials_need_four_times_the_memory() -> None:
    peaks = []
    for n in (300, 1200):
        given, trials = blocks(n, 7), np.repeat(np.arange(n), 5)
        tracemalloc.start()
        suspicious_rows(leave_one_out(*given), trials, np.tile(np.arange(5), n))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # With the square of the number of values it were sixteen times.
    assert peaks[1] < 6.0 * peaks[0]


def test_two_blunders_do_not_hide_one_another() -> None:
    generator = np.random.default_rng(1)
    design = np.column_stack([np.ones(60), np.linspace(-1.0, 1.0, 60)])
    left = generator.standard_normal(60)
    left[[10, 50]] += [9.0, 8.0]
    found = suspicious_rows(
        leave_one_out(left, design, np.eye(60)), np.arange(60), np.zeros(60, int)
    )
    assert [x.trial for x in found] == [10, 50]


def test_clean_tables_are_seldom_accused() -> None:
    generator = np.random.default_rng(2)
    design = generator.standard_normal((100, 8))
    trials, coordinates = np.repeat(np.arange(20), 5), np.tile(np.arange(5), 20)
    accused = sum(
        bool(
            suspicious_rows(
                leave_one_out(generator.standard_normal(100), design, np.eye(100)),
                trials,
                coordinates,
                level=0.05,
            )
        )
        for _ in range(400)
    )
    # 5 % are allowed, of which Bonferroni's bound leaves a part; five standard errors above that.
    assert 2 <= accused <= 0.05 * 400 + 5 * np.sqrt(400 * 0.05 * 0.95)


def test_where_many_stand_out_it_is_not_the_rows() -> None:
    left = np.random.default_rng(3).standard_normal(40)
    left[:12] += 30.0
    fitted = leave_one_out(left, np.zeros((40, 1)), np.eye(40))
    assert suspicious_rows(fitted, np.arange(40), np.zeros(40, int)) == []


def test_rounding_is_no_blunder() -> None:
    left = 1e-9 * np.random.default_rng(5).standard_normal(40)
    left[3] = 1e-7
    fitted = leave_one_out(left, np.zeros((40, 1)), np.eye(40))
    assert suspicious_rows(fitted, np.arange(40), np.zeros(40, int)) == []


def test_a_value_that_no_other_checks_is_not_judged() -> None:
    left, design = np.random.default_rng(4).standard_normal(30), np.zeros((30, 1))
    design[5] = 1.0
    left[5] = 1000.0
    fitted = leave_one_out(left, design, np.eye(30))
    assert suspicious_rows(fitted, np.arange(30), np.zeros(30, int)) == []


@pytest.mark.parametrize("states_noise", [True, False])
def test_a_fit_names_a_gross_row_and_says_what_it_is_without(states_noise: bool) -> None:
    model, laxity = clean_table("reference", 7)
    own = model.parameters.start
    spoilt = np.array(laxity.coordinates)
    spoilt[20, 3] += 10 * NOISE
    sd = laxity.sd if states_noise else None
    wrong = replace(laxity, coordinates=spoilt, sd=sd, within_trial_correlation=0.0)
    theta = fit(ik.LaxityResiduals(model=model, laxity=wrong), own).theta
    (row,) = contradicted_rows(model, wrong, theta)
    assert row.trial == 20
    assert row.coordinates[0] == 3
    assert row.off[0] == pytest.approx(10 * NOISE, abs=4 * NOISE)
    (found,) = row_findings(model, wrong, theta)
    assert found.where == wrong.protocol.trials[20]
    assert found.code == "trial-against-fit"
    assert found.values["off_varus_deg"] == pytest.approx(row.off[0])
    assert found.values["rmse_without_deg"] < found.values["rmse_deg"]
    right = replace(laxity, sd=sd)
    theta = fit(ik.LaxityResiduals(model=model, laxity=right), own).theta
    assert row_findings(model, right, theta) == ()


def test_the_row_that_cannot_be_right_is_found_without_a_model() -> None:
    laxity = ik.example_laxity("s192803")
    (row,) = suspicious_end_points(laxity)
    assert laxity.protocol.trials[row.trial] == "Valgus_60"
    assert row.p_value < 1e-6
    (found,) = end_point_findings(laxity)
    assert found.code == "trial-against-course"
    assert found.values["load"] == "9.6 N·m of valgus moment at 57 deg"
    kept = np.arange(laxity.n) != row.trial
    assert suspicious_end_points(laxity.select(kept)) == []


def repeated(laxity: ik.Laxity, rows: list[int]) -> ik.Laxity:
    """The table with some rows a second time, half a degree further flexed."""
    again = laxity.select(rows)
    protocol = replace(
        again.protocol,
        trials=tuple(f"{x} again" for x in again.protocol.trials),
        flexion_deg=again.protocol.flexion_deg + 0.5,
    )
    return ik.Laxity(
        protocol=concatenate([laxity.protocol, protocol], name="repeated"),
        coordinates=np.vstack([laxity.coordinates, again.coordinates]),
    )


def test_what_was_measured_twice_is_no_slip() -> None:
    laxity = ik.example_laxity("s192803")
    wrong = laxity.protocol.trials.index("Valgus_60")
    assert suspicious_end_points(repeated(laxity, list(range(laxity.n)))) == []
    others = [i for i in range(laxity.n) if i != wrong]
    (row,) = suspicious_end_points(repeated(laxity, others))
    assert row.trial == wrong


def test_trials_made_three_times_are_no_more_angles() -> None:
    once = ik.simulate(with_capsule(ik.reference_knee()), "table2").laxity
    names = [
        replace(once.protocol, trials=tuple(f"{x}_{k}" for x in once.protocol.trials))
        for k in "abc"
    ]
    laxity = ik.Laxity(
        protocol=concatenate(names, name="three"), coordinates=np.tile(once.coordinates, (3, 1))
    )
    assert suspicious_end_points(laxity) == []


def test_the_table_alone_says_nothing_of_ramps() -> None:
    assert suspicious_end_points(clean_table("reference", 7)[1]) == []


FRAMES = "registration=4deg,registration=4mm"


def test_a_diagnosis_says_the_verdict_without_the_row() -> None:
    _, laxity = clean_table("reference", 3)
    spoilt = np.array(laxity.coordinates)
    spoilt[20, 3] += 10 * NOISE
    few = [ik.effect_named(ik.reference_knee(), "shank_gravity")]
    answer = ik.diagnose("reference", replace(laxity, coordinates=spoilt), effects=few)
    first = answer.findings[0]
    assert (first.code, first.where) == ("trial-against-fit", laxity.protocol.trials[20])
    assert (first.values["verdict"], first.values["causes"]) == ("ADEQUATE", [])
    # As one error of ten times the noise it widens the noise that the load curves show.
    assert answer.verdict is ik.Verdict.ADEQUATE


@pytest.mark.usefixtures("no_conventions", "few_starts")
def test_a_diagnosis_leaves_out_the_row_that_cannot_be_right_and_doubts_the_forces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The second diagnosis, with the row, takes as long again.
    once = iter([investigate])
    monkeypatch.setattr(
        "identknee.verbs.diagnose.investigate",
        lambda *given, **named: next(once, lambda *_, **__: None)(*given, **named),
    )
    # Of the beginnings that a table without equilibria is searched from, one is enough here.
    monkeypatch.setattr("identknee.checks.usable_trials.STRETCHES", (0.04,))
    few = [ik.effect_named(ik.example("s192803"), "moment_gain_VV")]
    laxity = ik.example_laxity("s192803")
    stated = f"{FRAMES},insertions=2mm"
    answer = ik.diagnose("s192803", laxity, noise="5mm,10deg", uncertain=stated, effects=few)
    assert answer.trials_used == tuple(x for x in laxity.protocol.trials if x != "Valgus_60")
    (against,) = [x for x in answer.findings if x.where == "Valgus_60"]
    assert (against.code, against.values["verdict"]) == ("trial-against-course", "NOT_TESTABLE")
    # Four lines have several such fits, and processors differ in the one that is found.
    implausible = {"implausible-force", "implausible-strain", "one-sided-contact"}
    assert implausible & {x.code for x in answer.findings}
    assert not any("identknee diagnose" in x.sentence for x in answer.findings)
