"""What the summaries of several verbs have in common, as schemas."""

from collections.abc import Collection
from enum import Enum
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from identknee.runs.findings import Severity
from identknee.runs.schema import number, otherwise, refusal, shown

# Squares and ratios of anything larger may overflow on the page.
LARGEST = 1e100
AGAIN = "Run the command that made it again."


class Kept(BaseModel):
    """A part of a summary: what the page reads of it; it may hold more."""

    # Said again because tools that reload modules, as sphinx does, lose it.
    __pydantic_extra__: dict[str, Any] = Field(init=False)
    model_config = ConfigDict(strict=True, extra="allow", frozen=True)


def _moderate(value: float) -> float:
    if abs(value) > LARGEST:
        raise refusal(f"{value:g} is beyond anything a result holds", AGAIN)
    return value


Number = Annotated[float, number(remedy=AGAIN, remedy_infinite=AGAIN), AfterValidator(_moderate)]
Count = Annotated[int, Field(ge=0, le=10**15)]
Open = Number | None
Ends = Annotated[
    list[Open], Field(min_length=2, max_length=2), otherwise("{} is no interval", AGAIN)
]
Known = Annotated[
    list[Number], Field(min_length=2, max_length=2), otherwise("{} is no interval", AGAIN)
]
Point = Annotated[
    list[Number], Field(min_length=3, max_length=3), otherwise("{} is no point", AGAIN)
]
# By ligament, then by quantity.
Values = dict[str, dict[str, Number]]


def word_of(kind: type[Enum]) -> AfterValidator:
    """A text that must be the value of one of the members."""
    return word_in([str(x.value) for x in kind])


def word_in(known: Collection[str]) -> AfterValidator:
    """A text that must be one of these."""

    def check(word: str) -> str:
        if word not in known:
            raise refusal(f"{shown(word)} is none of {', '.join(known)}", AGAIN)
        return word

    return AfterValidator(check)


def same_keys(*tables: dict[str, Any] | None) -> bool:
    """Whether all tables have the keys of the first, and so on inside."""
    first, *others = tables
    if not isinstance(first, dict):
        return not any(isinstance(x, dict) for x in others)
    return all(isinstance(x, dict) and x.keys() >= first.keys() for x in others) and all(
        same_keys(first[key], *(x[key] for x in others if x is not None)) for key in first
    )


class Trial(Kept):
    """A trial to do."""

    trial: str
    flexion_deg: Number
    internal_moment_Nm: Open = None  # noqa: N815 - the unit
    varus_moment_Nm: Open = None  # noqa: N815
    anterior_force_N: Open = None  # noqa: N815
    distraction_force_N: Open = None  # noqa: N815
    lateral_force_N: Open = None  # noqa: N815


class Sentence(Kept):
    """Anything that is told in a sentence."""

    sentence: str


class Said(Sentence):
    """A finding of a verb about its own result."""

    severity: Annotated[str, word_of(Severity)]
    where: str


class Sizes(Kept):
    """An error of lengths and of angles."""

    mm: Open = None
    deg: Open = None


class Record(Kept):
    """How a result was made."""

    verb: str
    settings: dict[str, Any]
    inputs: dict[str, str]
    seed: int | None
    started: str
    seconds: Number


class Summary(Kept):
    """What every verb's summary holds."""

    record: Record
    findings: list[Said] | None = None
    assumptions: list[str] | None = None
