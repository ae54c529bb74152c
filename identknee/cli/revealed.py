"""What `identknee reveal` reads of a diagnosis, as a schema."""

from typing import Self

from pydantic import model_validator

from identknee.report.page.summary_parts import AGAIN, Ends, Kept, Point, Values
from identknee.runs.schema import refusal


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
