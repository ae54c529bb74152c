"""What the page reads of the summary of each verb, as schemas."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from identknee.identify.profile.result import ProfileVerdict, SideStatus
from identknee.report.page.summary_parts import (
    Count,
    Ends,
    Kept,
    Number,
    Open,
    Sentence,
    Summary,
    Trial,
    word_of,
)


class Side(Kept):
    """How one side of a profile ended."""

    error: Open
    reached: Number
    max_deviance: Number
    at_bounds: list[str]


class Profiled(Kept):
    """What a profile found of one quantity."""

    value: Number
    unit: str
    lower: Open
    upper: Open
    verdict: Annotated[str, word_of(ProfileVerdict)]
    intervals: list[Ends]
    level: Annotated[Number, Field(gt=0.0, lt=1.0)]
    n_simulations: Count


class Drawn(Profiled):
    """The same where its curve is to be drawn."""

    lower_status: Annotated[str, word_of(SideStatus)]
    upper_status: Annotated[str, word_of(SideStatus)]
    threshold: Number
    practical_level: Number
    n_restarts: Count
    lower_side: Side
    upper_side: Side


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


class Bounded(Kept):
    """Ends of a target."""

    lower: Open
    upper: Open


class Now(Bounded):
    """Ends of a target as it is known now."""

    unit: str
    value: Number


class Target(Kept):
    """What trials would bring for one target."""

    before: Now
    predicted: Bounded
    after: Bounded


class Design(Summary):
    """Of `design`."""

    trials: list[Trial]
    targets: Annotated[dict[str, Target], Field(min_length=1)]


SCHEMAS: Mapping[str, type[Summary]] = {
    "sample": Sample,
    "design": Design,
}
