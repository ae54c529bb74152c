"""What the sealed file of a blind case holds."""

from typing import Annotated, Any, NamedTuple

from pydantic import Field

from identknee.runs.schema import Number, Part

Point = Annotated[list[Number], Field(min_length=3, max_length=3)]


class Amplitude(NamedTuple):
    """A size and its unit."""

    value: Number
    unit: str


class TruthFile(Part):
    """The sealed part, opened."""

    seed: int
    effects: list[str]
    amplitudes: dict[str, dict[str, Amplitude]]
    theta: dict[str, Number]
    signal: Number
    is_largest: bool
    lines: dict[str, tuple[Point, Point]]
    facts: dict[str, Any]
    stated_errors: dict[str, Number] = Field(default_factory=dict)
