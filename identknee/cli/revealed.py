"""What `identknee reveal` reads of a diagnosis, as a schema."""

from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from identknee.runs.schema import number, otherwise, refusal

AGAIN = "Run the command that made it again."
# Squares and ratios of anything larger may overflow.
LARGEST = 1e100


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
Open = Number | None
Ends = Annotated[
    list[Open], Field(min_length=2, max_length=2), otherwise("{} is no interval", AGAIN)
]
Point = Annotated[
    list[Number], Field(min_length=3, max_length=3), otherwise("{} is no point", AGAIN)
]
# By ligament, then by quantity.
Values = dict[str, dict[str, Number]]


class Line(Kept):
    """Where a line of force runs."""

    femur: Point
    tibia: Point

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.femur == self.tibia:
            raise refusal("a line of force has no length", AGAIN)
        return self


class Amplitude(Kept):
    """An amplitude of a cause."""

    ci95: Ends


class Cause(Kept):
    """A cause found."""

    name: str
    parameters: dict[str, Amplitude] | None = None
    line: Line | None = None


class Revealed(Kept):
    """The result.json of a diagnosis."""

    verdict: str
    causes: list[Cause] | None = None
    group: list[str] | None = None
    line: Line | None = None
    parameters_before: Values | None = None
    parameters_after: Values | None = None
    parameters_before_ci95: dict[str, dict[str, Ends]] | None = None
    parameters_after_ci95: dict[str, dict[str, Ends]] | None = None
