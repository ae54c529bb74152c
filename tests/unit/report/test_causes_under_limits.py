"""What a diagnosis shows of causes where limits of plausibility count."""

from dataclasses import replace

from identknee.diagnosis.believability import CauseUnderLimits
from identknee.report.answers.diagnose import _under_limits
from identknee.runs.record import Outcome

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


def test_every_model_is_a_row_and_the_prices_are_said() -> None:
    said = _under_limits([NONE, CAPSULE])
    (table,) = said.tables
    assert [row[1:3] for row in table.rows] == [(74.4, 55.8), (0.6, 0.2)]
    assert "74.4" in said.sentence
    assert "0.6" in said.sentence
    assert said.is_answer


def test_what_is_not_known_is_said_to_be_so() -> None:
    unknown = replace(CAPSULE, log_limits_difference=None, log_limits_se=None)
    unknown = replace(unknown, log_data_difference=None)
    (table,) = _under_limits([NONE, unknown]).tables
    assert {*table.rows[1][3:]} == {"not known"}
    assert not _under_limits([replace(NONE, price=None, of_limits=None)]).tables
