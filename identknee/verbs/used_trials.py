"""Which measured trials a fit rests on, and where it begins so that these are as many as can be.

A trial without equilibrium is first compared under the share of its load that it bears, which
pulls the parameters to where it bears more, and at last left out.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import (
    Bounded,
    Problem,
    restricted,
    with_bounds,
    with_nuisance_priors,
    without_priors,
)
from identknee.calibrate.starts import load_start
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.laxity.zeros import from_zero
from identknee.mechanics.load_paths import Continuation
from identknee.model.laxity_model import LaxityModel
from identknee.model.measured_start import strains_as_measured
from identknee.model.residuals import LaxityResiduals, Weighting
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.progress import progress
from identknee.subject.knee import Knee
from identknee.verbs.barred import BarredSearch
from identknee.verbs.trial_sentences import about_paths, trial_names

# Of each ligament at the longest of its measured lengths: the best beginning is taken.
STRETCHES = (0.04, 0.06, 0.08, 0.1)
PATTERN_STRETCH = 0.06
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
MOST_ROUNDS, BUDGET = 8, 300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UsedTrials:
    """The data that a fit can rest on, and where it can begin.

    Attributes
    ----------
    laxity
        The data, cells of trials without equilibrium blank.
    start
        Where to begin, shape ``(p,)``; where the model begins at measured poses, all trials of
        the data have an equilibrium there.
    sentences
        What was done, for the user.
    """

    laxity: Laxity
    start: Array
    sentences: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The trials used."""
        return trial_names(self.laxity)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialSearch:
    """A search for parameters at which the measured trials have an equilibrium.

    Attributes
    ----------
    model
        The model of the data, begun at the measured poses where it can.
    laxity
        The data.
    weighting
        As for `LaxityResiduals`.
    bounds, fixed
        As for `identknee.fit`.
    """

    model: LaxityModel
    laxity: Laxity
    weighting: Weighting
    bounds: Mapping[str, tuple[float, float]]
    fixed: Sequence[str] = ()

    def used(self, start: Array) -> UsedTrials:
        """The trials to be fitted, and where to begin, at or away from `start`.

        Where trials have no equilibrium at the start, searches go from there; where the model
        begins at measured poses also from reference strains by the lengths of the ligaments there.
        Where no trial bears even its compression anywhere, all trials stay.
        """
        said = about_paths(self.model)
        lost = self.measured & ~self.has_equilibrium(start)
        used = self._past_bars(UsedTrials(laxity=self.laxity, start=start, sentences=said))
        if not lost.any() or (used.start is not start and len(used.names) == self.measured.sum()):
            return used
        beginnings = progress(
            self._beginnings(start).items(),
            description="looking for a start at which all trials have an equilibrium",
        )
        made = {x: self._regained(y) for x, y in beginnings}
        if not made:
            return UsedTrials(laxity=self.laxity, start=start, sentences=said)
        best = max(made, key=lambda x: self._worth(made[x].theta))
        theta = made[best].theta
        sentence = (
            f"At the start {lost.sum()} of {self.measured.sum()} measured trials had no "
            f"equilibrium. The fit began from {best}{_of(len(made))} "
            "and compared trials that did not bear their load under the share they bore, until "
            f"they did ({sum(x.n_simulations for x in made.values())} simulations)."
        )
        return self._past_bars(
            UsedTrials(
                laxity=self.with_equilibrium(theta),
                start=theta,
                sentences=(*said, sentence),
            )
        )

    def _past_bars(self, used: UsedTrials) -> UsedTrials:
        """The trials used and a start beyond those that bar the way of a search from there.

        Where the knee is exact its load paths are part of the model, and so are their ends.
        """
        if self.model.fallback_poses is None:
            return used
        free = self.problem(self.laxity).parameters.with_fixed(self.fixed, used.start)
        search = BarredSearch(
            compared=LaxityResiduals(model=self.model, laxity=self.laxity),
            problem=lambda part: restricted(self.problem(part), self.fixed, used.start),
            expand=free.expand,
        )
        beyond = search.run(free.restrict(used.start))
        if beyond is None:
            return used
        return replace(
            used,
            laxity=_blanked(self.laxity, beyond.is_left_out),
            start=free.expand(beyond.theta),
            sentences=(*used.sentences, beyond.sentence(self.laxity.protocol.trials)),
        )

    def fitted(self, start: Array, search: Callable[..., Fit]) -> tuple[UsedTrials, Fit]:
        """The trials used and the fit to them by `search`, again where it brings trials back."""
        used, found = self.refitted(self.used(start), search)
        return used, replace(found, start=start)

    def refitted(self, used: UsedTrials, search: Callable[..., Fit]) -> tuple[UsedTrials, Fit]:
        """The fit to the trials used, and to those it brings back until it brings back none."""
        for _ in range(MOST_ROUNDS):
            found = search(self.problem(used.laxity), used.start, fixed=self.fixed)
            back = self.with_equilibrium(found.theta)
            if len(trial_names(back)) <= len(used.names):
                break
            used = replace(used, laxity=back, start=found.theta)
        return used, found

    @property
    def _zero(self) -> tuple[Protocol, str]:
        return self.laxity.protocol, self.laxity.zero

    @property
    def measured(self) -> BoolArray:
        """Which trials have data, shape ``(n,)``."""
        return np.asarray(self.laxity.is_measured.any(axis=1))

    def has_equilibrium(self, theta: Array) -> BoolArray:
        """Which trials have an equilibrium, shape ``(n,)``."""
        found = self.model.predict(theta, derivatives=False).is_converged
        # A change needs both poses.
        return ~np.isnan(from_zero(np.where(found, 0.0, np.nan), *self._zero))

    def with_equilibrium(self, theta: Array) -> Laxity:
        """The data, cells of trials without equilibrium blank."""
        return _blanked(self.laxity, ~self.has_equilibrium(theta))

    def problem(self, laxity: Laxity) -> Problem:
        """The residuals of the model against `laxity`, with priors of the nuisances."""
        residuals = LaxityResiduals(model=self.model, laxity=laxity, weighting=self.weighting)
        return with_nuisance_priors(with_bounds(residuals, self.bounds))

    def _beginnings(self, start: Array) -> dict[str, Array]:
        """Where to begin, in words, and theta there, which some trial bears a load at."""
        begun = {"the start all the same": start}
        if self.model.poses is not None:
            of_each = "% of strain at the longest measured length of each ligament"
            begun |= {f"{100 * x:.0f} {of_each}": self._stretched(start, x) for x in STRETCHES}
        return {words: x for words, x in begun.items() if (self._borne(x) >= 0.0).any()}

    def _stretched(self, start: Array, stretch: float) -> Array:
        """Theta with reference strains as the measured poses have them, kept to the bounds."""
        parameters = self.problem(self.laxity).parameters
        n, m = self.model.tied.n, len(self.model.knee.ligaments)
        theta = np.array(start)
        strains = strains_as_measured(self.model.setting(start), stretch)[:m]
        theta[n : 2 * n] = self.model.tied.least_strain(strains)
        theta = np.clip(theta, parameters.lower, parameters.upper)
        held = [parameters.index(x) for x in self.fixed]
        theta[held] = start[held]
        return theta

    def _regained(self, theta: Array) -> Fit:
        """The best fit of a few, each with the loads that trials bear where the one before ended.

        It ends where all trials bear their load, or where they bear no more than before.
        """
        made: list[Fit] = []
        known: list[list[float]] = []
        for _ in range(MOST_ROUNDS):
            shares = self._borne(theta)
            if shares.tolist() in known:
                break
            known.append(shares.tolist())
            part = _blanked(_under(self.laxity, np.maximum(shares, 0.0)), shares < 0.0)
            found = fit(self.problem(part), theta, budget=BUDGET, fixed=self.fixed)
            made.append(found)
            theta = found.theta
        best = max(made, key=lambda x: self._worth(x.theta))
        return replace(best, n_simulations=sum(x.n_simulations for x in made))

    def _borne(self, theta: Array) -> Array:
        """The largest share of its load that each trial bears, -1 where none, shape ``(n,)``."""
        borne = np.full(self.laxity.n, -1.0)
        for share in SHARES:
            part = _under(self.laxity, np.full(self.laxity.n, share))
            bears = self.model.with_tests(part).predict(theta, derivatives=False).is_converged
            borne[bears & (borne < 0.0)] = share
            if (borne >= 0.0).all():
                break
        return borne

    def _worth(self, theta: Array) -> tuple[int, float]:
        """How many trials have an equilibrium, then how well they fit."""
        used = self.with_equilibrium(theta)
        residuals = self.problem(used).residuals(theta)
        return int(used.is_measured.any(axis=1).sum()), -float(residuals @ residuals)


def _of(n: int) -> str:
    return f", the best of {n} such beginnings," if n > 1 else ","


def residuals_of(problem: Problem) -> LaxityResiduals:
    """The residuals of the data of a problem that `TrialSearch` made."""
    inner = without_priors(problem)
    while isinstance(inner, Bounded):
        inner = inner.problem
    if not isinstance(inner, LaxityResiduals):
        raise TypeError(f"{type(inner).__name__} has no residuals of a table")
    return inner


def table_model(
    knee: Knee, laxity: Laxity, continuation: Continuation = "continuation"
) -> tuple[LaxityModel, tuple[str, ...]]:
    """The model of measured laxity, and what was changed of the knee's strains, as sentences.

    Of grouped bundles the pattern of strains is kept in all fits. Where trials have no equilibrium
    at the knee's own strains, these are no pattern to keep: it becomes the one that stretches each
    bundle alike at the longest of its measured lengths.
    """
    model = LaxityModel(knee=knee, protocol=laxity.protocol, continuation=continuation)
    model = model.with_tests(laxity)
    if not knee.groups or knee.fitted or model.poses is None:
        return model, ()
    measured = laxity.is_measured.any(axis=1)
    start = model.parameters.start
    if model.predict(start, derivatives=False).is_converged[measured].all():
        return model, ()
    strains = strains_as_measured(model.setting(start), PATTERN_STRETCH).tolist()
    tied = {member for group in knee.groups for member in group.members}
    ligaments = [
        replace(x, reference_strain_pct=strain) if x.name in tied else x
        for x, strain in zip(knee.ligaments, strains[: len(knee.ligaments)], strict=True)
    ]
    sentence = (
        "At the strains of the subject not all trials have an equilibrium, so grouped bundles keep "
        f"another pattern: that which stretches each by {100 * PATTERN_STRETCH:.0f} % at the "
        "longest of its measured lengths."
    )
    return replace(model, knee=knee.with_ligaments(ligaments)), (sentence,)


def testable(knee: Knee, laxity: Laxity, start: str) -> tuple[Knee, UsedTrials]:
    """The knee with strains at which trials have an equilibrium, and these trials.

    Strains away from which a fit has to begin are no prior knowledge: where it has, the knee's own
    become those of the beginning. Stated errors are as large there as the trials ask for.
    """
    model, said = table_model(knee, laxity)
    knee = model.knee
    trials = TrialSearch(model=model, laxity=laxity, weighting="unit", bounds={})
    begun = load_start(start, model.parameters)
    used = trials.used(begun)
    if used.start is begun:
        return knee, replace(used, sentences=(*said, *used.sentences))
    u, parameters = model.tied.n, model.parameters
    strains = model.tied.strain(used.start[u : 2 * u]).tolist()
    ligaments = tuple(
        replace(x, reference_strain_pct=strain)
        for x, strain in zip(knee.ligaments, strains, strict=True)
    )
    centred = "Priors of the reference strains are centred there."
    errors = zip(parameters.names[2 * u :], used.start[2 * u :].tolist(), strict=True)
    return replace(knee, ligaments=ligaments, fitted=dict(errors)), replace(
        used, sentences=(*said, *used.sentences, centred)
    )


def _blanked(laxity: Laxity, lost: BoolArray) -> Laxity:
    if not lost.any():
        return laxity
    return replace(laxity, coordinates=np.where(lost[:, None], np.nan, laxity.coordinates))


def _under(laxity: Laxity, shares: Array) -> Laxity:
    """The data as if each trial had borne a share of its load; compression stays, as it held."""
    if np.all(shares == 1.0):
        return laxity
    return replace(laxity, protocol=laxity.protocol.under(shares))
