"""What the page reads of the summary of each verb, as schemas."""

from collections.abc import Mapping

from identknee.report.page.summary_parts import (
    Kept,
    Open,
    Sentence,
    Summary,
)


class Probable(Kept):
    """The posterior of one parameter."""

    mean: Open
    sd: Open
    q025: Open
    q975: Open
    rhat: Open
    ess_bulk: Open


class Sample(Sentence, Summary):
    """Of `sample`."""

    outcome: str
    parameters: dict[str, Probable]


SCHEMAS: Mapping[str, type[Summary]] = {
    "sample": Sample,
}
