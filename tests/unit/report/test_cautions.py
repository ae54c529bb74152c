"""Warnings of several results, each said once."""

from identknee.report.page.cautions import told_once

FORCE = "Warning: The fit is not believable here: MCL carries {} N under 9.8 N·m at {} deg."


def test_what_two_results_say_with_other_numbers_is_said_once() -> None:
    said = [(FORCE.format(1262, 36), "fit"), (FORCE.format(1265, 6), "information")]
    assert told_once(said) == [FORCE.format(1262, 36)]


def test_a_result_may_say_the_same_of_two_trials() -> None:
    said = [("Warning: Valgus_60 is off.", "fit"), ("Warning: Valgus_30 is off.", "fit")]
    assert told_once(said) == [x for x, _ in said]
    # Also where another result says one of them.
    assert told_once([said[0], (said[1][0], "profile")]) == [x for x, _ in said]


def test_the_longer_of_two_that_begin_alike_stays() -> None:
    short, long = "Warning: a 2.", "Warning: a 3. The diagnosis leaves it out."
    assert told_once([(short, "fit"), (long, "diagnose")]) == [long]
    assert told_once([(long, "diagnose"), (short, "fit")]) == [long]


def test_sentences_with_one_beginning_are_one_and_errors_come_first() -> None:
    other = "Warning: The fit is not believable here: LCL is strained by 32 %."
    error = "Error: The table is wrong."
    said = told_once([(FORCE.format(1, 2), "fit"), (other, "fit"), (error, "fit")])
    assert said == [
        error,
        FORCE.format(1, 2).removesuffix(".") + "; LCL is strained by 32 %.",
    ]
