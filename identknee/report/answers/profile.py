"""What profile likelihoods say: which values are known within limits, and which are open."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from typing_extensions import override

from identknee.identify.profile.result import (
    EndOrigin,
    Profile,
    ProfileVerdict,
    Side,
    SideStatus,
)
from identknee.report.presenter import (
    BY_ASSUMPTION,
    CLOSED,
    Drawing,
    Presenter,
    Question,
    Range,
    Source,
    Statement,
    Table,
    open_ends_text,
    settings_of,
    table,
)
from identknee.runs.words import (
    amount,
    between,
    capitalised,
    contact_words,
    label,
    label_without_unit,
    listed,
    owner_words,
    parameter_words,
)
from identknee.subject.knee import Knee
from identknee.verbs.profile import Profiles

STIFFNESS = "stiffness_kN"
# More of them in one sentence are no answer any more.
MOST_NAMED = 5
# What beside data makes an end, in words.
ASSUMED: Mapping[EndOrigin | None, str] = {
    EndOrigin.PRIOR: "priors",
    EndOrigin.LIMIT: "limits of plausibility",
}
PROFILE_WORDS = {
    ProfileVerdict.IDENTIFIABLE: CLOSED,
    ProfileVerdict.BOUNDED_BY_ASSUMPTION: BY_ASSUMPTION,
    ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE: "not known",
    ProfileVerdict.STRUCTURALLY_SUSPECT: "not known",
    ProfileVerdict.MULTIMODAL: "several ranges",
    ProfileVerdict.UNDETERMINED: "not finished",
}


def parameter_statements(profiles: Sequence[Profile], given: str = "") -> Iterator[Statement]:
    """What profiles of parameters say, without those of predictions.

    Parameters
    ----------
    profiles
        Profiles of parameters.
    given
        What the first sentence begins with, as in ``"With noise of 0.5 mm, "``.
    """
    stiffness = [x for x in profiles if x.name.endswith(STIFFNESS)]
    others = [x for x in profiles if not x.name.endswith(STIFFNESS)]
    groups = (("stiffness", stiffness), ("other quantities", others))
    for k, (kind, group) in enumerate((name, x) for name, x in groups if x):
        first = [capitalised(f"{given}{_bounded_count_sentence(profiles)}")] if k == 0 else []
        yield Statement(
            question=Question.KNOWN,
            sentence=" ".join([*first, _quantity_sentences(group)]),
            tables=(_table(group, f"{100 * group[0].level:g} % profile intervals of {kind}"),),
            is_answer=k == 0,
        )


def _quantity_sentences(profiles: Sequence[Profile]) -> str:
    """All quantities of a group in one sentence; of many the best known and those left open."""
    chosen = list(profiles)
    if len(chosen) > MOST_NAMED:
        ranked = sorted(chosen, key=_width)
        is_open = [x for x in ranked if _width(x) == float("inf")]
        chosen = list(dict.fromkeys([ranked[0], *(is_open or ranked[-1:])]))
    kinds = [x.name.rpartition(".")[2] for x in chosen]
    # Of several of one kind in a row it is named once.
    words = [
        owner_words(x.name) if kind == before else parameter_words(x.name)
        for x, kind, before in zip(chosen, kinds, [None, *kinds[:-1]], strict=True)
    ]
    clauses = (f"{x} {quantity_clause(y)}." for x, y in zip(words, chosen, strict=True))
    return " ".join(map(capitalised, clauses))


def quantity_clause(profile: Profile) -> str:
    """What is known of a quantity, to follow its name."""
    low, high, unit = profile.lower, profile.upper, profile.unit
    if profile.verdict is ProfileVerdict.MULTIMODAL:
        parts = listed((between(x, unit) for x in profile.intervals), "or")
        return f"lies in one of several separate ranges ({parts})"
    if profile.verdict is ProfileVerdict.UNDETERMINED:
        return "is undecided, because a limit was not fully computed"
    if low == high == 0.0 and profile.unit == "N":
        return "is zero" if contact_words(profile.name.partition("@")[0]) else "is slack"
    assumed = [
        f"the {which} end "
        + (
            f"depends on the bound of {parameter_words(side.bound_of)}"
            if side.bound_of
            else f"is made by {ASSUMED[side.made_by]}"
        )
        for which, side in _assumed_ends(profile).items()
    ]
    hangs = f"; {listed(assumed)}" if assumed else ""
    if low is not None and high is not None:
        half = amount(0.5 * (high - low), unit, 2)
        claim = "is known to within" if profile.is_known else "lies within"
        doubt = "" if profile.doubt is None else f", {profile.doubt.value}"
        ends = f"{amount(low, '')} to {amount(high, unit)}"
        return f"{claim} ±{half} ({ends}{hangs}){doubt}"
    if low is not None or high is not None:
        end = (
            f"lower limit (at most {amount(high, unit)}"
            if low is None
            else f"upper limit (at least {amount(low, unit)}"
        )
        return f"has no {end}{hangs}{_feasibility_limits(profile)})"
    if profile.verdict is ProfileVerdict.STRUCTURALLY_SUSPECT:
        return "is not identifiable, and more data of this kind may not help"
    return f"is not determined: the data bound it on neither side{_feasibility_limits(profile)}"


def _assumed_ends(profile: Profile) -> dict[str, Side]:
    """The ends that the bound of another parameter, priors or limits make, and not the data."""
    sides = {"lower": profile.lower_side, "upper": profile.upper_side}
    return {
        which: side
        for which, side in sides.items()
        if side.bound_of is not None or side.made_by in ASSUMED
    }


def _feasibility_limits(profile: Profile) -> str:
    """Where the model and not the data ends a set, to follow what the data say; mostly empty."""
    places = [
        amount(side.reached, profile.unit)
        for side in (profile.lower_side, profile.upper_side)
        if side.status is SideStatus.OPEN_AT_FEASIBILITY
    ]
    return f"; the model has no equilibrium beyond {listed(places)}" if places else ""


def _width(profile: Profile) -> float:
    """Width of a set relative to its best value; infinite where it is open."""
    if profile.lower is None or profile.upper is None:
        return float("inf")
    return (profile.upper - profile.lower) / max(abs(profile.optimum_value), 1e-12)


def _bounded_count_sentence(profiles: Sequence[Profile]) -> str:
    n, level = len(profiles), 100 * profiles[0].level
    k = sum(
        x.lower is not None
        and x.upper is not None
        and x.verdict is not ProfileVerdict.BOUNDED_BY_ASSUMPTION
        for x in profiles
    )
    doubt = next((f", {x.doubt.value}" for x in profiles if x.doubt is not None), "")
    if n == 1:
        bound = "bound" if k else "do not bound"
        name = parameter_words(profiles[0].name)
        return f"at {level:g} % confidence the data {bound} {name} on both sides{doubt}."
    which = ("both" if n == 2 else f"all {n}") if k == n else f"{k or 'none'} of the {n}"
    owned = f"{which} ligament parameters"
    return f"at {level:g} % confidence the data bound {owned} on both sides{doubt}."


def _table(profiles: Sequence[Profile], title: str) -> Table:
    assumed = [
        ", ".join(
            f"{which}: bound of {label_without_unit(side.bound_of)}"
            if side.bound_of
            else f"{which}: {side.origin}"
            for which, side in _assumed_ends(x).items()
        )
        for x in profiles
    ]
    more = ("ends not made by data",) if any(assumed) else ()
    return table(
        title,
        (
            "quantity",
            ("lower end", None),
            ("best", None),
            ("upper end", None),
            "verdict",
            *more,
            "simulations",
        ),
        (
            (
                label(x.name),
                _end(x.lower_side),
                x.optimum_value,
                _end(x.upper_side),
                x.verdict_words,
                *(words for _ in more),
                x.n_simulations,
            )
            for x, words in zip(profiles, assumed, strict=True)
        ),
    )


def _end(side: Side) -> float | str:
    """An end of a set as a table shows it."""
    if side.end is not None:
        return float(side.end)
    if side.status is SideStatus.OPEN_AT_FEASIBILITY:
        return f"open, no equilibrium beyond {side.reached:.4g}"
    return str(side.status.value).replace("_", " ")


def profile_drawings(
    profiles: Sequence[Profile], truth: Mapping[str, float] | None = None
) -> Iterator[Drawing]:
    """Intervals and curves of profiles, beside the true values where these are known."""
    from identknee.report.parameter_figures import intervals_figure, profiles_figure

    names = listed(label(x.name) for x in profiles)
    ends = "; ".join(
        f"{label(x.name)} {_end_words(x.lower)} to {_end_words(x.upper)}, {x.verdict_words}"
        for x in profiles
    )
    yield Drawing(
        name="intervals",
        figure=intervals_figure(profiles, truth),
        caption="Confidence intervals of each quantity, nested from 50 % (thick) to 95 % (thin). "
        "An arrow marks an end that the data leave open, a cross one where the model ends.",
        description=f"Nested intervals of {names}. "
        f"At {100 * profiles[0].level:g} % confidence: {ends}.",
    )
    # The force of a slack ligament is one point.
    curves = [x for x in profiles if len(x.values) > 1]
    if not curves:
        return
    yield Drawing(
        name="profiles",
        figure=profiles_figure(curves),
        caption="Increase of the deviance when one value is fixed and all others are refitted."
        " Values below the dashed line are not excluded; a curve that stays below it is open "
        "on that side.",
        description=f"Profile likelihoods of {names}: a curve each that rises away from the best "
        "value, and the threshold as a dashed line.",
    )


def _end_words(value: float | None) -> str:
    return "open" if value is None else f"{value:.3g}"


def profile_range(profile: Profile) -> Range:
    """What a profile says of its quantity."""
    status = PROFILE_WORDS.get(profile.verdict) or open_ends_text(profile.lower, profile.upper)
    if profile.doubt is not None and profile.verdict is ProfileVerdict.IDENTIFIABLE:
        status = profile.doubt.value
    return Range(
        source=Source.PROFILE,
        low=profile.lower,
        high=profile.upper,
        value=profile.optimum_value,
        status=status,
    )


BATES = "Bates and Watts (1988), Nonlinear Regression Analysis, doi:10.1002/9780470316757"


class ProfilesPresenter(Presenter[Profiles]):
    """How profiles are shown."""

    @override
    def statements(self, answer: Profiles) -> Iterator[Statement]:
        """How many quantities are known, then one by one."""
        yield from parameter_statements(tuple(answer.parameters.values()))
        if answer.with_priors:
            yield self.say(
                "With the priors of ligament parameters, which are not data, intervals that the "
                "data leave open have these ends.",
                _table([*answer.with_priors.values()], "Profile intervals with priors"),
            )
        if profiles := [*answer.quantities.values()]:
            yield self.say(
                _quantity_sentences(profiles),
                _table(profiles, "Predictions that the data do not exclude"),
            )
        for pair in answer.pairs:
            closed = sum(x.status is SideStatus.CLOSED for x in pair.rays)
            names = listed(map(parameter_words, pair.names))
            yield self.say(
                f"The joint set of {names} is bounded along {closed} of {len(pair.rays)} "
                "paths from the best pair."
            )

    @override
    def drawings(self, answer: Profiles, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        yield from profile_drawings(answer.profiles)

    @override
    def ranges(self, answer: Profiles) -> Iterator[tuple[str, Range]]:
        yield from ((x.name, profile_range(x)) for x in answer.profiles)

    @override
    def method(self, answer: Profiles) -> Iterator[str]:
        profiles = answer.profiles
        if not profiles:
            return
        names = listed(dict.fromkeys(parameter_words(x.name) for x in profiles))
        yield (
            f"Profile likelihoods were computed of {names}: each was held at one value after "
            "another, and all others were fitted again."
        )
        settings = settings_of(answer)
        n = settings.get("bootstrap")
        degrees = answer.degrees_of_freedom
        law = "the chi-squared law with one degree of freedom"
        if n:
            law = f"{n} simulated data sets"
        elif degrees is not None:
            law = f"the F law with {degrees} degrees of freedom of the noise"
        for level in dict.fromkeys(x.level for x in profiles):
            rises = [x.threshold for x in profiles if x.level == level]
            limits = " to ".join(dict.fromkeys(f"{f(rises):.3g}" for f in (min, max)))
            yield (
                f"A {100 * level:g} % interval has the values at which the deviance rises by at "
                f"most {limits}, from {law}."
            )
        if settings.get("budget"):
            yield f"At most {settings['budget']} simulations were allowed for each profile."

    @override
    def sources(self, answer: Profiles) -> tuple[str, ...]:
        return () if answer.degrees_of_freedom is None else (BATES,)

    @override
    def joined(self, first: Profiles, later: Profiles) -> Profiles:
        return replace(
            first,
            parameters={**first.parameters, **later.parameters},
            quantities={**first.quantities, **later.quantities},
            with_priors={**first.with_priors, **later.with_priors},
            pairs=(*first.pairs, *later.pairs),
            assumptions=tuple(dict.fromkeys((*first.assumptions, *later.assumptions))),
        )
