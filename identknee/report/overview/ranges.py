"""What each method says of each parameter and force, side by side."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, unique
from typing import Any

import numpy as np

from identknee.identify.posterior.convergence import SampleOutcome
from identknee.identify.profile.result import Profile, ProfileVerdict
from identknee.runs.arrays import Array
from identknee.verbs.answer import Answer
from identknee.verbs.demo import Demonstration
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.equivalents import Equivalents
from identknee.verbs.information import LocalIdentifiability
from identknee.verbs.profile import Profiles
from identknee.verbs.sample import Sample

# Of a normal distribution, half of its central 95 %.
SDS_95 = 1.96
TAILS = (0.025, 0.5, 0.975)
NOT_CONVERGED = "not converged"
PROFILE_WORDS = {
    ProfileVerdict.IDENTIFIABLE: "known",
    ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE: "not known",
    ProfileVerdict.STRUCTURALLY_SUSPECT: "not known",
    ProfileVerdict.MULTIMODAL: "several ranges",
    ProfileVerdict.UNDETERMINED: "not finished",
}


@unique
class Source(Enum):
    """A method, the most telling first; the value is its name in a sentence."""

    PROFILE = "profile"
    POSTERIOR = "posterior"
    DIAGNOSIS = "diagnosis"
    CAUSE = "diagnosis with the cause"
    INFORMATION = "local approximation"
    EQUIVALENTS = "equivalent set"


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """What one method says of one quantity.

    Attributes
    ----------
    source
        The method.
    low, high
        Its 95 % set or range, in the unit of the quantity; None for an open end.
    value
        Its estimate; None where it has none.
    status
        What is known, in a word or three.
    reach
        The limit of the squared misfit that the range stands for, over the one of a 95 % set; a
        range of another limit is scaled by its root before it is compared. None where the two
        cannot be compared.
    """

    source: Source
    low: float | None
    high: float | None
    value: float | None
    status: str
    reach: float | None = 1.0

    @property
    def is_closed(self) -> bool:
        """Whether it has both ends."""
        return self.low is not None and self.high is not None

    @property
    def width(self) -> float:
        """From end to end; infinite where one is open."""
        if self.low is None or self.high is None:
            return float("inf")
        return self.high - self.low


def ranges_of(answers: Sequence[Answer]) -> dict[str, list[Range]]:
    """By the name of a parameter or force, what each method says of it, the most telling first.

    If two answers are of one kind, the later counts.
    """
    found: dict[str, dict[Source, Range]] = {}
    for answer in answers:
        read = _READ.get(type(answer))
        for name, own in () if read is None else read(answer):
            found.setdefault(name, {})[own.source] = own
    order = list(Source)
    return {
        name: sorted(by_source.values(), key=lambda x: order.index(x.source))
        for name, by_source in found.items()
    }


def _of_profile(profile: Profile) -> Range:
    return Range(
        source=Source.PROFILE,
        low=profile.lower,
        high=profile.upper,
        value=profile.optimum_value,
        status=PROFILE_WORDS.get(profile.verdict) or open_words(profile.lower, profile.upper),
    )


def open_words(low: float | None, high: float | None) -> str:
    """Which ends of a range are open.

    Examples
    --------
    >>> open_words(1.0, 2.0), open_words(1.0, None), open_words(None, None)
    ('known', 'open above', 'not known')
    """
    if low is None:
        return "not known" if high is None else "open below"
    return "open above" if high is None else "known"


def _profiles(answer: Profiles) -> Iterator[tuple[str, Range]]:
    yield from ((x.name, _of_profile(x)) for x in answer.profiles)


def _demo(answer: Demonstration) -> Iterator[tuple[str, Range]]:
    yield from ((x.name, _of_profile(x)) for x in answer.profiles.values())


def _sample(answer: Sample) -> Iterator[tuple[str, Range]]:
    status = "probable" if answer.outcome is SampleOutcome.CONVERGED else NOT_CONVERGED
    for name, x in answer.parameters.items():
        yield (
            name,
            Range(source=Source.POSTERIOR, low=x.q025, high=x.q975, value=x.q500, status=status),
        )
    if answer.predictive is not None and answer.data is not None:
        trials, ligaments = answer.data.protocol.trials, answer.predictive.ligaments
        tension = answer.predictive.tension_N
        draws = tension.reshape(-1, *tension.shape[-2:])
        yield from _forces(Source.POSTERIOR, _quantiles(draws), trials, ligaments, status)


def _quantiles(draws: Array) -> Array:
    """Shape ``(3, trial, ligament)``; NaN where a trial has no prediction at any draw."""
    known = np.isfinite(draws).any(axis=0)
    limits = np.nanquantile(np.where(known, draws, 0.0), TAILS, axis=0)
    return np.where(known, limits, np.nan)


def _forces(
    source: Source, limits: Array, trials: Sequence[str], ligaments: Sequence[str], status: str
) -> Iterator[tuple[str, Range]]:
    for i, trial in enumerate(trials):
        for j, ligament in enumerate(ligaments):
            low, value, high = limits[:, i, j].tolist()
            if np.isnan(value):
                continue
            own = Range(source=source, low=low, high=high, value=value, status=status)
            yield f"{ligament}.tension_N@{trial}", own


def _diagnosis(answer: Diagnosis) -> Iterator[tuple[str, Range]]:
    pairs = [(Source.DIAGNOSIS, answer.parameters_before, answer.parameters_before_ci95)]
    if answer.causes:
        pairs += [(Source.CAUSE, answer.parameters_after, answer.parameters_after_ci95)]
    for source, values, intervals in pairs:
        for owner, own in (values or {}).items():
            for kind, value in own.items():
                low, high = (intervals or {})[owner][kind]
                status = open_words(low, high)
                yield (
                    f"{owner}.{kind}",
                    Range(source=source, low=low, high=high, value=value, status=status),
                )


def _information(answer: LocalIdentifiability) -> Iterator[tuple[str, Range]]:
    found = answer.fisher
    for name, best, sd in zip(
        found.parameter_names, found.theta.tolist(), found.sd.tolist(), strict=True
    ):
        is_known = bool(np.isfinite(sd))
        low, high = (best - SDS_95 * sd, best + SDS_95 * sd) if is_known else (None, None)
        status = "known locally" if is_known else "not known"
        yield (
            name,
            Range(source=Source.INFORMATION, low=low, high=high, value=best, status=status),
        )


def _equivalents(answer: Equivalents) -> Iterator[tuple[str, Range]]:
    reach = answer.region.limit / SDS_95**2 if answer.criterion == "noise" else None
    for x in answer.region.extrema:
        yield (
            x.name,
            Range(
                source=Source.EQUIVALENTS,
                low=x.smallest,
                high=x.largest,
                value=x.at_fit,
                status="at least so uncertain",
                reach=reach,
            ),
        )


_READ: Mapping[type[Answer], Callable[[Any], Iterator[tuple[str, Range]]]] = {
    Profiles: _profiles,
    Demonstration: _demo,
    Sample: _sample,
    Diagnosis: _diagnosis,
    LocalIdentifiability: _information,
    Equivalents: _equivalents,
}
