"""What a diagnosis shows of causes where limits of plausibility count."""

from dataclasses import replace
from pathlib import Path

from identknee.diagnosis.believability import CauseUnderLimits
from identknee.report.presenter import Statement, statements_of
from identknee.runs.record import Outcome
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import load

NONE = CauseUnderLimits(
    names=(),
    price=74.4,
    of_limits=55.8,
    log_limits_difference=0.0,
    log_limits_se=0.0,
    log_data_difference=0.0,
    outcome=Outcome.MINIMUM,
    limits=(),
)
CAPSULE = replace(
    NONE, names=("posterior_capsule",), price=0.6, of_limits=0.2, log_data_difference=47.9
)


def said(*models: CauseUnderLimits) -> list[Statement]:
    """What a diagnosis says more where it has these."""
    diagnosis = load(Path(__file__).parents[2] / "fuzz" / "results" / "diagnose")
    assert isinstance(diagnosis, Diagnosis)
    before = {x.sentence for x in statements_of(diagnosis)}
    more = statements_of(replace(diagnosis, under_limits=models))
    return [x for x in more if x.sentence not in before]


def test_every_model_is_a_row_and_the_prices_are_said() -> None:
    (made,) = said(NONE, CAPSULE)
    (table,) = made.tables
    assert [row[1:3] for row in table.rows] == [(74.4, 55.8), (0.6, 0.2)]
    assert "74.4" in made.sentence
    assert "0.6" in made.sentence
    assert made.is_answer


def test_what_is_not_known_is_said_to_be_so() -> None:
    unknown = replace(CAPSULE, log_limits_difference=None, log_limits_se=None)
    unknown = replace(unknown, log_data_difference=None)
    ((table,),) = (x.tables for x in said(NONE, unknown))
    assert {*table.rows[1][3:]} == {"not known"}
    (made,) = said(replace(NONE, price=None, of_limits=None))
    assert not made.tables
    assert not made.is_answer
