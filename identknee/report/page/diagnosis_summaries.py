"""What the page reads of a diagnosis's summary, as schemas."""

from typing import Annotated, Self

from pydantic import model_validator

from identknee.diagnosis.explanations.refit import RivalState
from identknee.diagnosis.explanations.verdict import Verdict
from identknee.report.page.summary_parts import (
    AGAIN,
    Count,
    Ends,
    Kept,
    Number,
    Open,
    Point,
    Sentence,
    Summary,
    Trial,
    Values,
    same_keys,
    word_of,
)
from identknee.runs.schema import refusal


class Size(Kept):
    """An amplitude."""

    value: Open
    ci95: Ends


class Cause(Kept):
    """A cause found."""

    name: str
    meaning: str
    amplitude: Open
    unit: str
    ci95: Ends
    parameters: dict[str, Size]


class Line(Sentence):
    """A line of force that no known cause explains."""

    is_line: bool
    femur: Point | None
    tibia: Point | None


class Rival(Kept):
    """Another explanation."""

    causes: list[str]
    log_evidence_below: Open
    distance: Open
    state: Annotated[str, word_of(RivalState)] | None = None
    reason: str | None = None
    could_matter: bool = True


class Cell(Kept):
    """A field of the map of misfit."""

    coordinate: str
    flexion_deg: Number
    direction: str
    score: Number
    p_value: Number


class Misfit(Kept):
    """Where the model is wrong."""

    cells: list[Cell]
    share: Number
    chi_square_before: Open
    chi_square_after: Open
    n_measured: Count


class HeldOut(Kept):
    """An error of trials held out."""

    mm: Open = None
    deg: Open = None
    noise: Open


class Held(Kept):
    """Errors of trials held out by three models."""

    before: HeldOut
    after: HeldOut
    absorbed: HeldOut


class Gain(Kept):
    """What the cause gains on trials held out."""

    rmse_held_out: Held
    rmse_held_out_expected: Held

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        held = self.rmse_held_out
        if (held.after.noise is None) != (held.before.noise is None):
            raise refusal("one of the errors of trials held out is missing", AGAIN)
        return self


class Reach(Kept):
    """From what size a cause would be seen, and would matter."""

    detectable: Open
    relevant: Open
    unit: str


class Tested(Reach):
    """A cause that was tried."""

    cell: str
    score: Open


class Diagnosis(Sentence, Summary):
    """Of `diagnose` with data."""

    verdict: Annotated[str, word_of(Verdict)]
    reasons: list[str]
    causes: list[Cause]
    group: list[str]
    line: Line | None = None
    rivals: list[Rival]
    p_value: Open = None
    misfit: Misfit | None = None
    gain: Gain | None = None
    noise: Sentence | None = None
    parameters_before: Values | None = None
    parameters_after: Values | None = None
    parameters_before_ci95: dict[str, dict[str, Ends]] | None = None
    parameters_after_ci95: dict[str, dict[str, Ends]] | None = None
    effects: dict[str, Tested]
    advised_trials: list[Trial]
    advice: Sentence | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.p_value is not None and self.misfit is None:
            raise refusal("the misfit is missing", AGAIN)
        if not same_keys(
            self.parameters_before,
            self.parameters_after,
            self.parameters_before_ci95,
            self.parameters_after_ci95,
        ):
            raise refusal("the parameters before and after do not name the same", AGAIN)
        return self


class Together(Kept):
    """Causes that a protocol cannot tell apart."""

    effects: list[str]
    advised_trials: list[Trial]


class Planned(Summary):
    """Of `diagnose` without data."""

    n_trials: Count
    protocol: str
    effects: dict[str, Reach]
    look_alikes: dict[str, list[str]]
    groups: list[Together]
