"""The figures of each verb's results, drawn from what the verb stored."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from identknee.identify.profile.result import Profile
from identknee.identify.sweep import OUTCOMES
from identknee.laxity.table import COORDINATES
from identknee.report.equivalents_figures import ranges_figure, sets_figure
from identknee.report.information_figures import eigenvectors_figure, spectrum_figure
from identknee.report.page.drawing import Drawing
from identknee.report.page.model_drawings import (
    design_drawings,
    diagnosis_drawings,
    isolability_drawings,
)
from identknee.report.page.results import Result
from identknee.report.profile_figures import intervals_figure, profiles_figure
from identknee.report.sample_figures import corner_figure, forces_figure, prior_posterior_figure
from identknee.report.sensitivity_figures import effects_figure, map_figure
from identknee.report.starts_figure import starts_figure
from identknee.report.sweep_figures import KIND_WORDS, start_end_figure, waterfall_figure
from identknee.runs.arrays import Array
from identknee.runs.words import label, label_without_unit, listed
from identknee.verbs.demo import Demonstration
from identknee.verbs.equivalents import Equivalents
from identknee.verbs.information import LocalIdentifiability
from identknee.verbs.profile import Profiles
from identknee.verbs.sample import Sample
from identknee.verbs.sample_records import Predictive
from identknee.verbs.sensitivity import GlobalSensitivity
from identknee.verbs.sweep import Sweep

MOST_DRAWS = 400
MOST_FORCES = 16
QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
INDICES = {"mu_star": "mean absolute effect, mu*", "ST": "total Sobol index, ST"}


def drawings(result: Result) -> tuple[Drawing, ...]:
    """All figures of a result, the most telling first; none of a verb whose answer is a table."""
    draw = _BY_VERB.get(result.verb)
    return () if draw is None else tuple(draw(result))


def _demo(result: Result) -> Iterator[Drawing]:
    answer = result.answer
    if not isinstance(answer, Demonstration):
        return
    methods = listed(dict.fromkeys(x.method for x in answer.starts))
    yield Drawing(
        name="starts",
        figure=starts_figure(answer.starts),
        caption="Left: the error of the fitted stiffnesses. Right: how well the same fits "
        "reproduce the laxity. Each dot is one run.",
        description=f"Errors of fits by {methods} from every start. Laxity is reproduced to "
        f"{max(x.rmse_deg.max() for x in answer.starts):.2f} deg at worst, with stiffnesses up to "
        f"{max(x.error_kN.max() for x in answer.starts):.2f} kN wrong on average.",
    )
    truth = {f"{x}.{k}": v for x, own in answer.truth.items() for k, v in own.items()}
    yield from _profile_drawings(tuple(answer.profiles.values()), truth)


def _profiles(result: Result) -> Iterator[Drawing]:
    if isinstance(result.answer, Profiles):
        yield from _profile_drawings(result.answer.profiles)


def _profile_drawings(
    profiles: Sequence[Profile], truth: Mapping[str, float] | None = None
) -> Iterator[Drawing]:
    names = listed(label(x.name) for x in profiles)
    ends = "; ".join(
        f"{label(x.name)} {_end(x.lower)} to {_end(x.upper)}, {x.verdict.value.replace('_', ' ')}"
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
        caption="How much worse the fit becomes when one value is held and all others are fitted "
        "again. Values below the dashed line are not excluded; a curve that stays below it is open "
        "on that side.",
        description=f"Profile likelihoods of {names}: a curve each that rises away from the best "
        "value, and the threshold as a dashed line.",
    )


def _sample(result: Result) -> Iterator[Drawing]:
    answer = result.answer
    if not isinstance(answer, Sample) or answer.draws is None:
        return
    names, draws = answer.space.names, _thinned(answer.draws.theta)
    told = listed(map(label, names))
    yield Drawing(
        name="prior-posterior",
        figure=prior_posterior_figure(names, _thinned(answer.prior.theta), {"posterior": draws}),
        caption="What was assumed of each parameter before the data (grey), and what is "
        "probable given the data.",
        description=f"Densities of {told} before and after the data.",
    )
    yield Drawing(
        name="corner",
        figure=corner_figure(names, draws),
        caption="Every pair of parameters: 50 and 95 % of the posterior lie inside the lines. "
        "Oblong shapes are parameters that compensate for one another.",
        description=f"Pairwise posterior of {told}.",
    )
    if answer.predictive is not None and answer.data is not None:
        yield _forces(answer.predictive, answer.data.protocol.trials)


def _forces(predictive: Predictive, names: Sequence[str]) -> Drawing:
    tensions = predictive.tension_N.reshape(-1, *predictive.tension_N.shape[-2:])
    # A trial may have no prediction anywhere.
    known = np.flatnonzero(np.isfinite(tensions).any(axis=(0, 2)))
    spread = np.nanquantile(tensions[:, known], QUANTILES, axis=0)
    widths = (spread[-1] - spread[0]).max(axis=1)
    chosen = np.sort(np.argsort(-widths)[:MOST_FORCES])
    trials = [names[i] for i in known[chosen]]
    return Drawing(
        name="forces",
        figure=forces_figure(trials, predictive.ligaments, np.moveaxis(spread[:, chosen], 0, -1)),
        caption="Ligament forces in the trials where they are least certain, around their medians: "
        "thick bars hold 50 %, thin bars 95 % of the posterior.",
        description=f"Ranges of the tension of {listed(predictive.ligaments)} in {len(trials)} "
        f"trials; the widest has {widths.max():.0f} N.",
    )


def _information(result: Result) -> Iterator[Drawing]:
    if not isinstance(result.answer, LocalIdentifiability):
        return
    found = result.answer.fisher
    yield Drawing(
        name="spectrum",
        figure=spectrum_figure({result.subject: found}),
        caption="How well the data determine each combination of parameters, from stiff to sloppy. "
        "A bar marks what rounding alone would give.",
        description=f"Eigenvalues of the information from {found.eigenvalues[0]:.3g} to "
        f"{found.eigenvalues[-1]:.3g}; {found.n_above_noise} of {found.theta.size} stand above "
        "the solver's noise.",
    )
    yield Drawing(
        name="eigenvectors",
        figure=eigenvectors_figure(found),
        caption="Which parameters make up each of these combinations, one column each.",
        description=f"The least known combination is {found.combination(found.theta.size - 1)}.",
    )


def _equivalents(result: Result) -> Iterator[Drawing]:
    answer = result.answer
    if not isinstance(answer, Equivalents):
        return
    region, names = answer.region, answer.region.parameter_names
    apart = answer.coordinates - answer.coordinates.mean(axis=0)
    bands = {label(x): apart[:, :, j] for j, x in enumerate(COORDINATES)}
    yield Drawing(
        name="sets",
        figure=sets_figure(names, region.sets, region.fit, bands, origin="the mean"),
        caption="Above: parameter sets that this measurement cannot tell apart, one line each. "
        "Below: how little their laxity differs, trial by trial.",
        description=f"{region.n_sets} equivalent sets of {listed(map(label, names))}, and the "
        "spread of their laxity.",
    )
    forces = sorted(region.quantities.values(), key=lambda x: x.smallest - x.largest)
    if widest := forces[:MOST_FORCES]:
        shown = [label_without_unit(x.name) for x in widest]
        ends = np.array([(x.smallest, x.largest) for x in widest])
        # Forces of hundreds of N that differ by a few would all be ticks on one axis.
        at_fit = np.array([x.at_fit for x in widest])
        apart = {"equivalent sets": ends - at_fit[:, None]}
        named = [f"{x}, {y:.0f} N" for x, y in zip(shown, at_fit, strict=True)]
        yield Drawing(
            name="force-ranges",
            figure=ranges_figure(named, 0.0 * at_fit, apart, unit="tension minus the fit's [N]"),
            caption="Smallest and largest ligament force among these sets, where they differ most, "
            "beside that of the fit (its name and size on the left).",
            description=f"Force ranges; the widest is {shown[0]}, {ends[0, 0]:.0f} to "
            f"{ends[0, 1]:.0f} N.",
        )


def _sweep(result: Result) -> Iterator[Drawing]:
    if not isinstance(result.answer, Sweep):
        return
    searches = result.answer.searches
    number = np.arange(1.0, searches.n + 1.0)
    curves = {
        "end": (number, np.sort(searches.objectives)),
        "polished": (number, np.sort(searches.polished_objectives)),
    }
    told = listed(f"{n} {KIND_WORDS[kind]}" for kind, n in searches.kinds.items())
    if np.isfinite(searches.objectives).any():
        yield Drawing(
            name="waterfall",
            figure=waterfall_figure({f"{searches.n} starts": curves}),
            caption="Objective at which each search ended, the best first. A step is a place where "
            "several searches ended.",
            description=f"Objectives of {searches.n} searches in ascending order: {told}.",
        )
    kinds = [OUTCOMES[code].value for code in searches.kind_codes]
    names, best = searches.parameters.names, searches.polished[searches.best]
    yield Drawing(
        name="basins",
        figure=start_end_figure(
            {"": (searches.starts, searches.ends, kinds)}, names, best, mark="best end"
        ),
        caption="Where searches began (coloured by how they ended) and where they ended (black), "
        "in the plane of each ligament's two parameters.",
        description=f"Starts and ends of {searches.n} searches: {told}.",
    )


def _sensitivity(result: Result) -> Iterator[Drawing]:
    if not isinstance(result.answer, GlobalSensitivity):
        return
    found = result.answer.analysis
    name = next((x for x in INDICES if x in found.indices), None)
    if name is None:
        return
    index, parameters = found.indices[name], found.parameters.names
    groups = [(i, result.answer.group_named(x)) for i, x in enumerate(found.groups)]
    by_coordinate: dict[str, list[tuple[int, str]]] = {}
    for i, x in groups:
        if x is not None:
            by_coordinate.setdefault(label(x.coordinate), []).append((i, x.place))
    # Results of earlier versions have the names of the groups only.
    by_coordinate = by_coordinate or {"": list(enumerate(found.groups[:-1]))}
    tables = {
        name: ([place for _, place in rows], index.final[[i for i, _ in rows]])
        for name, rows in by_coordinate.items()
    }
    yield Drawing(
        name="influence",
        figure=map_figure(tables, parameters, INDICES[name]),
        caption="How much each parameter (across) moves each kind of laxity (down): dark means "
        "strongly.",
        description=f"{INDICES[name]} of {listed(map(label, parameters))} by coordinate, flexion "
        "and load.",
    )
    if name == "mu_star":
        size, width, spread = index.final, index.final_half_widths, found.indices["sigma"].final
        # The last group is failure.
        order = np.argsort(-np.nan_to_num(size[:-1], nan=-1.0).max(axis=1))
        panels = {
            _panel(result.answer, found.groups[i]): (size[i], width[i], spread[i])
            for i in order[:2]
        }
        yield Drawing(
            name="effects",
            figure=effects_figure(panels, parameters),
            caption="The two kinds of laxity that move most. Farther right an effect is stronger; "
            "farther up it depends more on the other parameters.",
            description=f"Morris effects of {listed(map(label, parameters))}.",
        )


def _panel(answer: GlobalSensitivity, name: str) -> str:
    group = answer.group_named(name)
    return name if group is None else f"{label(group.coordinate)}, {group.place}"


def _thinned(theta: Array) -> Array:
    """Some of the draws of all chains, evenly apart, shape ``(n, p)``."""
    flat = theta.reshape(-1, theta.shape[-1])
    chosen = np.linspace(0, len(flat) - 1, min(len(flat), MOST_DRAWS)).astype(int)
    return np.asarray(flat[chosen])


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.3g}"


_BY_VERB: Mapping[str, Callable[[Result], Iterator[Drawing]]] = {
    "demo": _demo,
    "profile": _profiles,
    "sample": _sample,
    "information": _information,
    "equivalents": _equivalents,
    "sweep": _sweep,
    "sensitivity": _sensitivity,
    "diagnose": diagnosis_drawings,
    "isolability": isolability_drawings,
    "design": design_drawings,
}
