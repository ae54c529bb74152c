"""What a fit says against itself: misfit, bounds, starts that disagree."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ClosedForm, plain_parameters
from scipy import stats

from identknee.calibrate.fit import fit
from identknee.checks.fit_checks import (
    bound_findings,
    common_scale_findings,
    conditional_findings,
    distinct_ends,
    misfit_findings,
    misfit_probability,
    parameters_at_zero,
    start_findings,
    too_few_findings,
    unstated_misfit_findings,
)
from identknee.checks.table_checks import IMPROBABLE
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.runs.findings import (
    Doubt,
    Severity,
    by_severity,
    doubt_of,
    finding,
    finding_lines,
)
from identknee.runs.schema import summary_of
from identknee.subject.reference import reference_knee

NAMES = ("ACL.stiffness_kN", "PCL.stiffness_kN", "ACL.reference_strain_pct")


@pytest.fixture
def parameters() -> Parameters:
    """Two stiffnesses and a strain, within the bounds of every knee."""
    return Parameters(
        names=NAMES,
        center=np.array([10.0, 18.0, 8.0]),
        lower=np.array([0.0, 0.0, -15.0]),
        upper=np.array([40.0, 40.0, 15.0]),
        prior_sd=np.array([0.3, 0.3, 3.0]),
        is_log=np.array([True, True, False]),
    )


def test_a_misfit_is_judged_by_the_chi_square_of_what_is_left() -> None:
    # 100 values and 10 parameters: 90 degrees of freedom.
    limit = float(stats.chi2.isf(IMPROBABLE, 90))
    assert misfit_findings(0.999 * limit, 100, 10) == ()
    (found,) = misfit_findings(1.001 * limit, 100, 10)
    assert (found.code, found.severity) == ("misfit-improbable", Severity.WARNING)
    assert found.values["degrees_of_freedom"] == 90
    (gross,) = misfit_findings(9.1 * 90, 100, 10)
    assert (gross.code, gross.severity) == ("misfit-gross", Severity.ERROR)
    assert gross.values["ratio"] == pytest.approx(9.1)


def test_intervals_are_conditional_where_one_fit_in_twenty_would_leave_so_much() -> None:
    limit = float(stats.chi2.isf(0.05, 90))
    assert conditional_findings(0.999 * limit, 100, 10) == ()
    (found,) = conditional_findings(1.001 * limit, 100, 10)
    assert found.code == "conditional-on-misfit"
    assert found.kind.doubt is Doubt.MISFIT
    assert found.values["n"] == 100
    assert found.values["deviance"] == 1.001 * limit
    assert found.values["p"] == pytest.approx(stats.chi2.sf(1.001 * limit, 90))
    both = conditional_findings(9.1 * 90, 100, 10)
    assert [x.code for x in both] == ["conditional-on-misfit", "misfit-gross"]
    assert misfit_probability(1e6, 8, 8) == misfit_probability(np.inf, 100, 8) == 1.0


def test_the_gravest_doubt_of_findings_is_theirs() -> None:
    (misfit,) = conditional_findings(300.0, 100, 10)
    contact = finding(
        "one-sided-contact",
        "contact",
        {"medial_N": 1, "lateral_N": 2, "compression_N": 3, "n_trials": 4, "source": "x"},
    )
    assert doubt_of([contact, misfit]) is Doubt.MISFIT
    assert doubt_of([contact]) is Doubt.IMPLAUSIBLE
    assert doubt_of([finding("no-loads", "data")]) is None


def test_what_cannot_be_judged_is_not() -> None:
    assert misfit_findings(1e6, 5, 8) == ()
    assert misfit_findings(np.inf, 100, 8) == ()
    (note,) = unstated_misfit_findings(0.4, np.nan)
    assert (note.code, note.severity) == ("noise-unstated", Severity.INFO)


@pytest.mark.parametrize(
    ("sizes", "values"),
    [
        ((0.5, 9.2), {"rmse_deg": 9.2}),
        ((2.4, None), {"rmse_mm": 2.4}),
        ((3.0, 6.0), {"rmse_mm": 3.0, "rmse_deg": 6.0}),
    ],
)
def test_errors_that_no_instrument_has_are_errors(
    sizes: tuple[float, float | None], values: dict[str, float]
) -> None:
    (found,) = unstated_misfit_findings(*sizes)
    assert (found.code, found.severity) == ("error-large", Severity.ERROR)
    assert dict(found.values) == values


def test_fewer_values_than_parameters_are_said() -> None:
    assert too_few_findings(8, 8) == ()
    (found,) = too_few_findings(1, 8)
    assert (found.code, found.severity) == ("too-few-values", Severity.WARNING)
    assert dict(found.values) == {"n_values": 1, "n_parameters": 8}


def test_parameters_at_either_bound_are_named(parameters: Parameters) -> None:
    assert bound_findings(np.array([10.0, 18.0, 8.0]), parameters) == ()
    theta = np.array([40.0, 1e-9, 8.0])
    (found,) = bound_findings(theta, parameters)
    assert (found.code, found.severity) == ("at-bound", Severity.WARNING)
    assert found.values["parameters"] == list(NAMES[:2])
    assert found.values["bounds"] == [40.0, 0.0]
    # What the user holds there is no finding.
    (one,) = bound_findings(theta, parameters, fixed=["PCL.stiffness_kN"])
    assert one.values["parameters"] == [NAMES[0]]


def test_what_stands_at_a_bound_of_zero_is_absent(parameters: Parameters) -> None:
    assert parameters_at_zero(np.array([10.0, 0.0, 8.0]), parameters) == ("PCL.stiffness_kN",)
    # Neither a value next to zero, nor one of zero within its bounds.
    assert parameters_at_zero(np.array([10.0, 1e-3, 0.0]), parameters) == ()


def test_starts_that_fit_as_well_elsewhere_disagree(parameters: Parameters) -> None:
    best = np.array([10.0, 18.0, 8.0])
    thetas = best + np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 6.0, 0.0]])
    # 3 % of a typical step apart is the same; beyond the threshold the data decide.
    assert start_findings(thetas[:2], np.array([300.0, 300.01]), parameters) == ()
    assert start_findings(thetas, np.array([300.0, 300.01, 304.0]), parameters) == ()
    (found,) = start_findings(thetas, np.array([300.0, 300.01, 303.5]), parameters)
    assert (found.code, found.severity) == ("starts-disagree", Severity.WARNING)
    assert (found.values["n_apart"], found.values["n_starts"]) == (1, 3)
    assert found.values["parameters"][0] == "PCL.stiffness_kN"


def test_a_minimum_that_one_start_alone_found_is_doubtful(parameters: Parameters) -> None:
    thetas = np.array([[10.0, 18.0, 8.0], [12.0, 18.0, 8.0], [9.0, 9.0, 9.0]])
    (found,) = start_findings(thetas, np.array([300.0, 350.0, np.inf]), parameters)
    assert found.code == "lowest-found-once"
    assert dict(found.values) == {"n_starts": 3, "rise_of_next": 50.0}
    assert start_findings(thetas[:1], np.array([300.0]), parameters) == ()
    assert start_findings(thetas, np.full(3, np.inf), parameters) == ()


def test_terminal_and_file_show_the_gravest_first() -> None:
    findings = (
        *unstated_misfit_findings(0.1, 0.1),
        *misfit_findings(150.0, 100, 10),
        *misfit_findings(9e3, 100, 10),
    )
    assert [x.split(":")[0] for x in finding_lines(findings)[:2]] == ["Error", "Warning"]
    stored = [summary_of(x) for x in by_severity(findings)]
    assert [x["code"] for x in stored] == ["misfit-gross", "misfit-improbable", "noise-unstated"]
    assert stored[1]["values"]["chi_square"] == 150.0


@pytest.mark.parametrize(("factor", "way"), [(0.1, "more compliant"), (9.8, "stiffer")])
def test_ligaments_all_scaled_alike_point_to_the_unit_of_loads(factor: float, way: str) -> None:
    model = LaxityModel(knee=reference_knee(), protocol=load_protocol("drawer"))
    theta = np.array(model.parameters.center)
    theta[:4] *= factor * np.array([1.0, 1.5, 0.8, 1.2])
    (found,) = common_scale_findings(model, theta)
    assert found.code == "stiffness-scaled"
    assert found.values["way"] == way
    assert found.values["times"] == pytest.approx(10.0, rel=0.15)


@pytest.mark.parametrize(
    "times", [[1, 1, 1, 1], [0.3, 0.3, 0.3, 0.3], [0.1, 0.1, 0.1, 1.0], [0, 0.1, 0.1, 0.1]]
)
def test_ligaments_that_differ_or_are_near_are_not_scaled(times: list[float]) -> None:
    model = LaxityModel(knee=reference_knee(), protocol=load_protocol("drawer"))
    theta = np.array(model.parameters.center)
    theta[:4] *= times
    assert common_scale_findings(model, theta) == ()


def test_ends_that_fit_as_well_count_once() -> None:
    """Of ends by their deviances above the lowest: one twice, one beyond 3.84."""
    problem = ClosedForm(
        name="flat",
        parameters=plain_parameters(1),
        start=np.zeros(1),
        minimum=np.zeros(1),
        lowest=0.0,
        residuals_at=lambda x: np.array([0.5 * x[0]]),
        jacobian_at=lambda _: np.array([[0.5]]),
    )
    begun = fit(problem, problem.start)
    places = (0.0, 1e-3, 3.0, 3.001, 4.0)
    ends = [replace(begun, theta=np.array([x]), objective=0.5 * (0.5 * x) ** 2) for x in places]
    assert [x.theta[0] for x in distinct_ends(ends)] == [0.0, 3.0]
    assert [x.theta[0] for x in distinct_ends(ends, scale=2.0)] == [0.0, 3.0, 4.0]
    assert distinct_ends(ends[:1]) == (ends[0],)
