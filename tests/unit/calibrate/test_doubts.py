"""What a fit says against itself: misfit, bounds, starts that disagree."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from identknee.calibrate.doubts import (
    IMPROBABLE,
    at_zero,
    bound_findings,
    misfit_findings,
    start_findings,
    too_few_findings,
    unstated_misfit_findings,
)
from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.starts import SecondSearch, second_search
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.findings import Severity, finding_lines, findings_summary

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
    assert found.severity is Severity.WARNING
    assert "with 90 degrees of freedom" in found.sentence
    (gross,) = misfit_findings(9.1 * 90, 100, 10)
    assert gross.severity is Severity.ERROR
    assert "leaves 9.1 times the misfit" in gross.sentence


def test_what_cannot_be_judged_is_not() -> None:
    assert misfit_findings(1e6, 5, 8) == ()
    assert misfit_findings(np.inf, 100, 8) == ()
    (note,) = unstated_misfit_findings(0.4, np.nan)
    assert note.severity is Severity.INFO
    assert "could not be judged" in note.sentence


@pytest.mark.parametrize(
    ("sizes", "said"),
    [((0.5, 9.2), "leaves 9.2 deg,"), ((2.4, None), "leaves 2.4 mm,"), ((3.0, 6.0), "3 mm and 6")],
)
def test_errors_that_no_instrument_has_are_errors(
    sizes: tuple[float, float | None], said: str
) -> None:
    (found,) = unstated_misfit_findings(*sizes)
    assert found.severity is Severity.ERROR
    assert said in found.sentence


def test_fewer_values_than_parameters_are_said() -> None:
    assert too_few_findings(8, 8) == ()
    (found,) = too_few_findings(1, 8)
    assert found.severity is Severity.WARNING
    assert found.sentence.startswith("Only 1 value was measured for 8 free parameters")
    assert "7 values were" in too_few_findings(7, 8)[0].sentence


def test_parameters_at_either_bound_are_named(parameters: Parameters) -> None:
    assert bound_findings(np.array([10.0, 18.0, 8.0]), parameters) == ()
    theta = np.array([40.0, 1e-9, 8.0])
    (found,) = bound_findings(theta, parameters)
    assert (found.severity, found.where) == (Severity.WARNING, "parameters")
    assert "2 parameters stand at a bound" in found.sentence
    assert "ACL stiffness (40 kN) and PCL stiffness (0 kN)" in found.sentence
    # What the user holds there is no finding.
    (one,) = bound_findings(theta, parameters, fixed=["PCL.stiffness_kN"])
    assert "1 parameter stands" in one.sentence


def test_what_stands_at_a_bound_of_zero_is_absent(parameters: Parameters) -> None:
    assert at_zero(np.array([10.0, 0.0, 8.0]), parameters) == ("PCL.stiffness_kN",)
    # Neither a value next to zero, nor one of zero within its bounds.
    assert at_zero(np.array([10.0, 1e-3, 0.0]), parameters) == ()


def test_starts_that_fit_as_well_elsewhere_disagree(parameters: Parameters) -> None:
    best = np.array([10.0, 18.0, 8.0])
    thetas = best + np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 6.0, 0.0]])
    # 3 % of a typical step apart is the same; beyond the threshold the data decide.
    assert start_findings(thetas[:2], np.array([300.0, 300.01]), parameters) == ()
    assert start_findings(thetas, np.array([300.0, 300.01, 304.0]), parameters) == ()
    (found,) = start_findings(thetas, np.array([300.0, 300.01, 303.5]), parameters)
    assert (found.severity, found.where) == (Severity.WARNING, "starts")
    assert "1 of 3 ended at other parameters" in found.sentence
    assert "PCL stiffness 18 or 24 kN" in found.sentence


def test_a_minimum_that_one_start_alone_found_is_doubtful(parameters: Parameters) -> None:
    thetas = np.array([[10.0, 18.0, 8.0], [12.0, 18.0, 8.0], [9.0, 9.0, 9.0]])
    (found,) = start_findings(thetas, np.array([300.0, 350.0, np.inf]), parameters)
    assert "Only one of 3 starts" in found.sentence
    assert "higher by 50" in found.sentence
    assert start_findings(thetas[:1], np.array([300.0]), parameters) == ()
    assert start_findings(thetas, np.full(3, np.inf), parameters) == ()


def test_terminal_and_file_show_the_gravest_first() -> None:
    findings = (
        *unstated_misfit_findings(0.1, 0.1),
        *misfit_findings(150.0, 100, 10),
        *misfit_findings(9e3, 100, 10),
    )
    assert [x.split(":")[0] for x in finding_lines(findings)[:2]] == ["Error", "Warning"]
    assert [x["severity"] for x in findings_summary(findings)] == ["info", "warning", "error"]


class TwoWells:
    """A problem with one parameter and two minima: 8 kN exactly, and one near 30 kN by `floor`."""

    def __init__(self, parameters: Parameters, floor: float) -> None:
        self.parameters = parameters
        self._floor = floor

    def residuals(self, theta: Array) -> Array:
        x = theta[0]
        return np.array([(x - 8.0) * (x - 30.0) / 50.0, self._floor * (x - 8.0) / 22.0])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[(2.0 * theta[0] - 38.0) / 50.0], [self._floor / 22.0]])


@pytest.mark.parametrize(
    ("start", "floor", "severity", "said"),
    [
        (35.0, 0.5, Severity.ERROR, "ended at a lower misfit"),
        (5.0, 0.0, Severity.INFO, "the start is not the reason"),
        (35.0, 0.0, Severity.WARNING, "other parameters (ACL stiffness 30 or 8 kN)"),
    ],
)
def test_a_second_search_says_whether_both_agree(
    parameters: Parameters, start: float, floor: float, severity: Severity, said: str
) -> None:
    problem = TwoWells(parameters.select(NAMES[:1]), floor)
    again = second_search(problem, fit(problem, [start]))
    # The knee has no PCL, LCL and MCL, so no guess of the paper; its own value is left.
    assert again.name == "subject"
    found = again.finding
    assert (found.severity, found.where) == (severity, "starts")
    assert said in found.sentence
    assert again.is_better is (severity is Severity.ERROR)


def test_a_second_search_that_ends_higher_is_a_disagreement(parameters: Parameters) -> None:
    problem = TwoWells(parameters.select(NAMES[:1]), 0.0)
    first = fit(problem, [5.0])
    worse: Fit = replace(first, objective=2.0)
    found = SecondSearch(name="IG1", first=replace(first, objective=1.0), second=worse).finding
    assert found.severity is Severity.WARNING
    assert "from IG1, ended at a higher misfit (objective 2, here 1)" in found.sentence


def test_the_second_search_keeps_what_is_fixed_and_begins_elsewhere(
    parameters: Parameters,
) -> None:
    problem = TwoWells(parameters, 0.0)
    # Only the first parameter moves the residuals; their Jacobian has one column a parameter.
    problem.jacobian = lambda theta: np.array(  # type: ignore[method-assign]
        [[(2.0 * theta[0] - 38.0) / 50.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    )
    first = fit(problem, parameters.center, fixed=["PCL.stiffness_kN"])
    again = second_search(problem, first)
    assert again.name == "the middle of the bounds"
    np.testing.assert_array_equal(again.second.start, [20.0, 18.0, 0.0])
    assert again.second.theta[1] == 18.0
