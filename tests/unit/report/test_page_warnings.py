"""Warnings of several results, each shown once."""

from identknee.report.page.page import merge_duplicate_warnings
from identknee.runs.findings import Finding, finding


def force(newtons: float, load: str, ligament: str = "MCL") -> Finding:
    values = {
        "ligament": ligament,
        "force_N": newtons,
        "load": load,
        "failure_N": 557.0,
        "source": "Wijdicks 2010",
    }
    return finding("implausible-force", ligament, values)


def trial(name: str, **values: object) -> Finding:
    return finding(
        "trial-against-fit", name, {"p_value": 0.1, **values}, sentence=f"{name} is off."
    )


def test_what_two_results_find_with_other_numbers_is_shown_once() -> None:
    first, again = force(1262.0, "9.8 N·m at 36 deg"), force(1265.0, "9.8 N·m at 6 deg")
    assert merge_duplicate_warnings([(first, "fit"), (again, "information")]) == [first]


def test_a_result_may_find_the_same_of_two_trials() -> None:
    one, other = trial("Valgus_60"), trial("Valgus_30")
    assert merge_duplicate_warnings([(one, "fit"), (other, "fit")]) == [one, other]
    # Also where another result finds one of them.
    assert merge_duplicate_warnings([(one, "fit"), (other, "profile")]) == [one, other]


def test_of_two_the_one_with_more_values_stays() -> None:
    short, long = trial("a"), trial("a", verdict="ADEQUATE")
    assert merge_duplicate_warnings([(short, "fit"), (long, "diagnose")]) == [long]
    assert merge_duplicate_warnings([(long, "diagnose"), (short, "fit")]) == [long]
    other = trial("a", rmse_mm=1.0)
    assert merge_duplicate_warnings([(other, "fit"), (long, "diagnose")]) == [other, long]


def test_findings_with_one_lead_are_one_and_errors_come_first() -> None:
    one, other = force(1262.0, "valgus"), force(700.0, "varus", "LCL")
    error = finding("moves-against-load", "data", sentence="The table is wrong.")
    said = merge_duplicate_warnings([(one, "fit"), (other, "fit"), (error, "fit")])
    assert said[0] is error
    assert len(said) == 2
    assert said[1].sentence.endswith(f": {one.detail}; {other.detail}.")


def test_what_an_earlier_version_stored_is_shown_as_it_is() -> None:
    old = [
        Finding(severity=one.severity, sentence=one.sentence, where=one.where)
        for one in (force(1262.0, "valgus"), force(1265.0, "valgus"))
    ]
    assert merge_duplicate_warnings([(x, str(i)) for i, x in enumerate(old)]) == old
    assert len(merge_duplicate_warnings([(old[0], "fit"), (old[0], "profile")])) == 1
