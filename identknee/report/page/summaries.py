"""What the page reads of the summary of each verb, as schemas."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from identknee.diagnosis.verdict import Verdict as Conclusion
from identknee.identify.profile.result import SideStatus, Verdict
from identknee.report.page.summary_parts import (
    AGAIN,
    Count,
    Ends,
    Kept,
    Known,
    Number,
    Open,
    Point,
    Sentence,
    Sizes,
    Summary,
    Trial,
    Values,
    same_keys,
    word_in,
    word_of,
)
from identknee.runs.outcome import Outcome
from identknee.runs.schema import refusal

ENDS = ("minimum", "valley", "cliff", "start_failed")


class Side(Kept):
    """How one side of a profile ended."""

    error: Open
    is_cliff: bool
    reached: Number
    max_deviance: Number
    at_bounds: list[str]


class Profiled(Kept):
    """What a profile found of one quantity."""

    value: Number
    unit: str
    lower: Open
    upper: Open
    verdict: Annotated[str, word_of(Verdict)]
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


class Profiles(Summary):
    """Of `profile`."""

    parameters: dict[str, Profiled]
    quantities: dict[str, Profiled] = Field(default_factory=dict)


class Errors(Kept):
    """Mean errors of parameters."""

    kN: Number  # noqa: N815 - the unit
    pct: Number


class Rmse(Kept):
    """Root mean square errors of laxity."""

    mm: Number
    deg: Number


class Start(Kept):
    """Fits from one start by one method."""

    method: str
    start: str
    error: Errors
    rmse: Rmse
    n_simulations: Number


class Demo(Summary):
    """Of `demo`."""

    starts: list[Start]
    profiles: dict[str, Profiled]
    noise: Rmse | None = None

    @model_validator(mode="after")
    def _has_both(self) -> Self:
        for method in ("complex", "least-squares"):
            if not any(x.method == method for x in self.starts):
                raise refusal(f"there is no fit by {method} in it", AGAIN)
        return self


class Simulated(Kept):
    """How a trial ended."""

    trial: str
    outcome: str
    reason: str


class Simulation(Summary):
    """Of `simulate`."""

    n_converged: Count
    n_trials: Count
    trials: list[Simulated]


class Fit(Sentence, Summary):
    """Of `fit`."""

    outcome: str
    rmse: Sizes
    parameters: Values
    start_parameters: Values

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if not same_keys(self.parameters, self.start_parameters):
            raise refusal("parameters and start_parameters do not name the same", AGAIN)
        return self


class Failed(Sentence, Summary):
    """Of `fit` where the model has no prediction at the start."""


class Basin(Kept):
    """A minimum found by a sweep."""

    objective: Number
    n_starts: Count
    share: Number
    parameters: dict[str, Number]


class Sweep(Summary):
    """Of `sweep`."""

    n_starts: Count
    kinds: dict[Annotated[str, word_in(ENDS)], Count]
    n_basins: Count
    basins: list[Basin]

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if any(x.parameters.keys() != self.basins[0].parameters.keys() for x in self.basins):
            raise refusal("its basins do not name the same parameters", AGAIN)
        return self


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


class Collinear(Kept):
    """Parameters that stand in for one another."""

    parameters: list[str]


class Eigenvalue(Kept):
    """How well a combination is known."""

    combination: str
    value: Open
    floor: Open


class Information(Summary):
    """Of `information`."""

    structure: Sentence
    collinear: list[Collinear]
    eigenvalues: list[Eigenvalue]
    n_simulations: Count


class Range(Kept):
    """The least and the largest value among equivalent sets."""

    unit: str
    fit: Open
    lower: Open
    upper: Open


class Equivalents(Summary):
    """Of `equivalents`."""

    parameters: dict[str, Range]
    quantities: dict[str, Range]


class Largest(Kept):
    """The laxity that a parameter moves most."""

    group: str
    value: Open


class Influence(Kept):
    """An index of one parameter."""

    largest: Largest


class Sensitivity(Summary):
    """Of `sensitivity`."""

    method: str
    indices: Annotated[
        dict[str, Annotated[dict[str, Influence], Field(min_length=1)]], Field(min_length=1)
    ]


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


class Diagnosis(Summary):
    """Of `diagnose` with data."""

    verdict: Annotated[str, word_of(Conclusion)]
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
    parameters_before_ci95: dict[str, dict[str, Known]] | None = None
    parameters_after_ci95: dict[str, dict[str, Known]] | None = None
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
    "demo": Demo,
    "simulate": Simulation,
    "fit": Fit,
    "sweep": Sweep,
    "profile": Profiles,
    "sample": Sample,
    "information": Information,
    "equivalents": Equivalents,
    "sensitivity": Sensitivity,
    "diagnose": Diagnosis,
    "design": Design,
}


def schema_of(verb: str, summary: Mapping[str, Any]) -> type[Summary]:
    """The schema of a verb's summary: some verbs leave less where there was nothing to compute."""
    if verb == "diagnose" and "verdict" not in summary:
        return Planned
    if verb == "fit" and summary.get("outcome") == Outcome.START_FAILED.value:
        return Failed
    return SCHEMAS[verb]
