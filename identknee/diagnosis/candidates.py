"""What every effect of a library would add to the residuals of a fit, and which are excluded."""

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from identknee.checks.fit_checks import BEYOND_PRIOR
from identknee.diagnosis.fitting import FAR_EVIDENCE, FittedModel, Refit, refit
from identknee.diagnosis.force_rows import ForceRows
from identknee.diagnosis.score import (
    LEVEL,
    MOST_SIGNED,
    Cell,
    ProjectedSignature,
    Scores,
    ScoreTest,
    Signature,
    classify_effect,
    detectable_amplitude,
    detection_power,
    project_signature,
    score_test,
)
from identknee.mechanics.pose import coordinate_jacobian
from identknee.model.effects.effect import OF, Effect
from identknee.model.effects.facts import FACTS
from identknee.model.effects.readings import Remounting, remounting
from identknee.model.effects.structures import MissingStructure, Structure
from identknee.model.effects.tissues import InsertionShift, LigamentBundles, moved_insertion
from identknee.model.line_loads import added_line_tensions
from identknee.model.mechanics_inputs import PER_KN
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, IntArray, declared, entries, entry, frozen
from identknee.runs.words import PLAIN, unit_of
from identknee.subject.knee import BONES

# Reference strains [%] and shifts of the insertions [mm] at which a missing structure is tried.
STRAINS = (-4.0, 0.0, 4.0, 8.0)
SHIFT = 6.0
# Femoral x and y, tibial x: among the six amplitudes after stiffness and strain.
SHIFTED = (2, 3, 5)
# Length of the whitened residuals: an amplitude of a prior standard deviation that does less is
# unseen to first order, and its effect at that amplitude is taken instead.
UNSEEN = 1e-6


# An effect and all of its amplitudes.
Sized = tuple[Effect, Array]


@declared
class Variant:
    """One signature of an effect, and the start of a refit with it."""

    effect: Effect = entry("Effect of the library")
    signature: Signature = entry(
        "Signature of those amplitudes that change the residuals to first order"
    )
    values: Array = entry("All amplitudes where the signature was taken, shape ``(a,)``")
    moved: IntArray = entry("Which of them the columns of the signature belong to")
    is_secant: bool = entry(
        "Whether the effect has no first derivative, so that its score holds for one size only",
        default=False,
    )

    def start(self, amplitude: Array) -> Array:
        """All amplitudes with those of the signature as given, within their bounds, ``(a,)``."""
        values = np.array(self.values)
        values[self.moved] += amplitude
        parameters = self.effect.parameters
        return np.asarray(np.clip(values, parameters.lower, parameters.upper))


def library_variants(fitted: FittedModel, effects: Sequence[Effect]) -> tuple[Variant, ...]:
    """Signatures of all effects at a fit, those of structures for a grid of sites and strains.

    Derivatives are those of the fitted model's predictions, for an effect without any where it does
    nothing (such as bundles) those half way to a prior standard deviation.
    """
    grid = [x for x in effects if isinstance(x, MissingStructure) and x.sites_vary]
    found = list(_tangents(fitted, [x for x in effects if x not in grid]))
    for structure in grid:
        found += _at_sites(fitted, structure)
    return tuple(found)


def _tangents(fitted: FittedModel, effects: Sequence[Effect]) -> Iterator[Variant]:
    """One variant per effect; for structures with fixed insertions one per reference strain."""
    tried = [(effect, values) for effect in effects for values in _baselines(effect)]
    for (effect, values), changes in zip(tried, _null_columns(fitted, tried), strict=True):
        p = effect.parameters
        size = np.linalg.norm(changes, axis=0) * p.prior_sd
        seen = size > UNSEEN
        is_secant = not seen.any()
        if is_secant:
            (changes,) = _columns(fitted, [(effect, secant_amplitudes(effect, values))])
            seen = np.linalg.norm(changes, axis=0) * p.prior_sd > UNSEEN
        if not seen.any():
            continue
        moved = np.flatnonzero(seen)
        strain = values[effect.first_shift - 1] if isinstance(effect, Structure) else None
        # What distinguishes effects of one name.
        place = effect.variant if isinstance(effect, InsertionShift | LigamentBundles) else ""
        yield Variant(
            effect=effect,
            signature=Signature(
                name=effect.name,
                variant=place if strain is None else f"strain {strain:g} %",
                columns=changes[:, moved],
                prior_sd=p.prior_sd[moved],
                sign=_signs(p)[moved],
            ),
            values=values,
            moved=moved,
            is_secant=is_secant,
        )


def _baselines(effect: Effect) -> list[Array]:
    """Amplitudes of no effect."""
    values = np.array(effect.parameters.center)
    if not isinstance(effect, Structure):
        return [values]
    is_strain = np.arange(len(values)) == effect.first_shift - 1
    return [np.where(is_strain, strain, values) for strain in STRAINS]


def _null_columns(fitted: FittedModel, tried: Sequence[Sized]) -> list[Array]:
    """The columns of effects at amplitudes at which none does anything.

    There effects do not influence one another, so those of different names share a prediction.
    """
    found: dict[int, Array] = {}
    while len(found) < len(tried):
        together: dict[str, int] = {}
        for i, (effect, _) in enumerate(tried):
            if i not in found:
                together.setdefault(effect.name, i)
        places = list(together.values())
        found |= zip(places, _columns(fitted, [tried[i] for i in places]), strict=True)
    return [found[i] for i in range(len(tried))]


def _columns(fitted: FittedModel, added: Sequence[Sized]) -> list[Array]:
    """Whitened derivatives by the amplitudes of effects that act together, ``(m, a)`` each."""
    base, sizes = fitted.model, [len(values) for _, values in added]
    model = base.with_effects([*base.effects, *(effect for effect, _ in added)])
    theta = np.concatenate([fitted.theta, *(values for _, values in added)])
    # Forces share the prediction; without any, that of the fit is kept in its place.
    prediction = (model.predict_once if fitted.laxity.has_forces else model.predict)(theta)
    used = fitted.laxity.is_measured.any(axis=1)
    columns = np.zeros((fitted.n_data, sum(sizes)))
    if prediction.jacobian is not None and prediction.is_converged[used].all():
        of_forces = ForceRows(model=model, laxity=fitted.laxity).jacobian(theta)
        columns = fitted.columns(
            prediction.jacobian[:, :, len(fitted.theta) :], of_forces[:, len(fitted.theta) :]
        )
    return np.split(columns, np.cumsum(sizes)[:-1], axis=1)


def secant_amplitudes(effect: Effect, values: Array) -> Array:
    """Amplitudes at which a second-order effect has the slope of the secant to its end.

    Half a prior standard deviation of those of one sign from `values`; those of either sign act by
    their side.
    """
    p = effect.parameters
    return np.where(p.lower >= values, np.minimum(values + 0.5 * p.prior_sd, p.upper), values)


def _at_sites(fitted: FittedModel, structure: MissingStructure) -> list[Variant]:
    """Variants of a missing structure on a grid of sites and reference strains."""
    # No shift, each of three coordinates shifted alone, all three together: 15 amplitudes.
    moves = [np.zeros(structure.parameters.n)]
    for i, sign in product(SHIFTED, (-1.0, 1.0)):
        moves.append(np.zeros(structure.parameters.n))
        moves[-1][i] = sign * SHIFT
    for signs in product((-1.0, 1.0), repeat=len(SHIFTED)):
        moves.append(np.zeros(structure.parameters.n))
        moves[-1][list(SHIFTED)] = np.array(signs) * SHIFT
    strains = np.array(STRAINS)
    m = len(structure.femoral)
    femoral = np.concatenate([structure.femoral + x[2:5] for x in moves])
    tibial = np.concatenate([structure.tibial + x[5:8] for x in moves])
    model, prediction = fitted.model, fitted.model.predict_once(fitted.theta)
    found = []
    for strain in strains:
        unit, own = np.ones(len(femoral)), np.full(len(femoral), 0.01 * strain)
        shape = added_line_tensions(model, prediction, (femoral, tibial), unit, own)
        pulls = PER_KN * shape.by_stiffness[:, :, None] * shape.lengthening
        pulls = pulls.reshape(len(prediction.codes), len(moves), m, 5).sum(axis=2)
        gradients = pulls.transpose(0, 2, 1)
        columns = fitted.columns(
            pose_changes(fitted, gradients), fitted.forces.changes(fitted.theta, gradients)
        )
        found += [
            _site_variant(structure, move, float(strain), columns[:, [k]])
            for k, move in enumerate(moves)
            if np.linalg.norm(columns[:, k]) > UNSEEN
        ]
    return found


def pose_changes(fitted: FittedModel, gradients: Array) -> Array:
    """Changes of the coordinates (n, 5, k) by additions (n, 5, k) to the gradient of the energy."""
    prediction = fitted.model.predict_once(fitted.theta)
    if prediction.hessians is None:  # pragma: no cover - only mesh contact has none
        raise AssertionError
    moved = -np.linalg.solve(prediction.hessians, gradients)
    return np.asarray(coordinate_jacobian(prediction.poses) @ moved)


def _site_variant(
    structure: MissingStructure, move: Array, strain: float, column: Array
) -> Variant:
    p = structure.parameters
    shift = ", ".join(f"{x:+.0f}" for x in move[list(SHIFTED)])
    values = np.array(move)
    values[1] = strain
    return Variant(
        effect=structure,
        signature=Signature(
            name=structure.name,
            variant=f"strain {strain:g} %, shifted by {shift} mm",
            columns=column,
            prior_sd=p.prior_sd[:1],
            sign=_signs(p)[:1],
        ),
        values=frozen(values, p.n, name="values"),
        moved=np.array([0]),
    )


def _signs(parameters: Parameters) -> IntArray:
    """1 or -1 for amplitudes that have one sign only, 0 for the rest.

    Too many signs for a signature, as those of the bundles of many ligaments, are left to the
    bounds of the refit.
    """
    positive, negative = parameters.lower >= 0.0, parameters.upper <= 0.0
    if np.count_nonzero(positive | negative) > MOST_SIGNED:
        return np.zeros(parameters.n, np.int64)
    return np.asarray(positive.astype(np.int64) - negative.astype(np.int64))


@declared
class Detectability:
    """Detectable size of an effect in the data or under a protocol."""

    name: str = entry("Name of the effect")
    parameter: str = entry(
        "Amplitude that the sizes are of: in the unit of the first, the hardest to see"
    )
    unit: str = entry("Unit of the amplitude")
    detectable: float = entry(
        "Size that the test finds in nine of ten data sets; null where it finds no plausible one",
        unit="unit of the amplitude",
    )
    relevant: float = entry("The smallest size worth knowing", unit="unit of the amplitude")
    power: float = entry("How often the test finds that size", unit="1")


@declared
class Exclusion(Detectability):
    """Result for one effect: detected, excluded, or without power."""

    cell: Cell = entry("The answer: significant or not, crossed with power")
    score: float = entry("Score of the effect, as a z-score", unit="1")
    p_value: float = entry("Probability of a largest score as high by chance", unit="1")


@declared
class CandidateCauses:
    """The candidate causes and their score test."""

    variants: tuple[Variant, ...] = entry("Signatures of all effects")
    test: ScoreTest = entry("The max-score test of them")

    def projected(self, variant: Variant) -> ProjectedSignature:
        """Signature of a variant, projected off the fitted parameters."""
        return self.test.signature(variant.signature.name, variant.signature.variant)

    def typical(self, name: str) -> Variant | None:
        """The variant of an effect at the least unusual amplitudes; None if it is never seen.

        A missing structure then lies where anatomy puts it, with an ordinary strain.
        """
        own = [x for x in self.variants if x.effect.name == name]

        def distance_from_prior(x: Variant) -> float:
            p = x.effect.parameters
            return float(np.sum(((x.values - p.center) / p.prior_sd) ** 2))

        return min(own, key=distance_from_prior, default=None)

    def visibility(self, effect: Effect) -> Detectability:
        """The detectable size of an effect."""
        relevant = FACTS[effect.name.rpartition(OF)[2]].relevant
        variant = self.typical(effect.name)
        if variant is None:
            name = effect.parameters.names[0]
            detectable, power = float("nan"), LEVEL
        else:
            # The amplitude hardest to see, its detectable size, and the power at `relevant`.
            signature = self.projected(variant)
            names = [variant.effect.parameters.names[i] for i in variant.moved]
            unit = unit_of(names[0])
            # Two amplitudes without a unit need not be comparable.
            alike = [k for k, x in enumerate(names) if k == 0 or unit_of(x) == unit != ""]
            least = min(alike, key=lambda k: signature.gram[k, k])
            amplitude = np.zeros(len(names))
            amplitude[least] = relevant * (signature.signature.sign[least] or 1)
            name, p = names[least], variant.effect.parameters
            detectable = detectable_amplitude(self.test, signature, least)
            place = int(variant.moved[least])
            if detectable > max(abs(p.lower[place]), abs(p.upper[place])):
                # No knee has an effect of that size.
                detectable = float("nan")
            power = detection_power(self.test, signature, amplitude)
        return Detectability(
            name=effect.name,
            parameter=name.partition(".")[2],
            unit=unit_of(name) or PLAIN,
            detectable=detectable,
            relevant=relevant,
            power=power,
        )

    def exclusion(self, effect: Effect, scores: Scores) -> Exclusion:
        """The result of the score test for an effect."""
        seen = self.visibility(effect)
        scored = next((x for x in scores.candidates if x.name == effect.name), None)
        score, p_value = (0.0, 1.0) if scored is None else (scored.score, scored.p_value)
        return Exclusion(
            **{name: getattr(seen, name) for name in entries(Detectability)},
            cell=classify_effect(is_significant=p_value <= LEVEL, power=seen.power),
            score=score,
            p_value=p_value,
        )


def library_candidates(
    fitted: FittedModel, effects: Sequence[Effect], *, seed: int
) -> CandidateCauses:
    """Signatures of all effects at a fit, and the test of them for noise of unknown size."""
    variants = library_variants(fitted, effects)
    signatures = [x.signature for x in variants]
    test = score_test(fitted.scored_projector, signatures, seed=seed, scale="unknown")
    return CandidateCauses(variants=variants, test=test)


# Errors of zeros are fitted only if they score more: without them the score is 0 to 1, with errors
# of 0.3 mm and deg 8 and more.
LEAST_SCORE = 4.0
# Mean number of trials per angle that separates its zero from the effect of loads.
LEAST_TRIALS = 5


@declared
class BeyondPrior:
    """Insertions whose estimates lie beyond their prior."""

    causes: tuple[InsertionShift, ...] = entry("The insertions beyond it, each as a cause")
    p_value: float = entry(
        "Probability that the farthest of all nuisances lies so far out by chance; 1 without any"
    )


def insertions_beyond_prior(fitted: FittedModel) -> BeyondPrior:
    """The insertions that a fit moves farther than 3 standard deviations of what is stated."""
    knee = fitted.model.knee
    places = {f"insertion.{x.name}_{y}": (x.name, y) for x in knee.ligaments for y in BONES}
    groups = fitted.nuisance_groups
    chance = {x.name: len(groups) * x.p_value for x in groups if x.name in places}
    beyond = {name: p_value for name, p_value in chance.items() if p_value < BEYOND_PRIOR}
    return BeyondPrior(
        causes=tuple(moved_insertion(knee, *places[name]) for name in beyond),
        p_value=min(beyond.values(), default=1.0),
    )


def remounting_errors(base: Refit, best: Refit) -> Remounting | None:
    """Errors of zero at each angle where they explain a misfit far better than `best`; else None.

    Other causes leave much the same in all trials of an angle, so these errors are no candidate
    beside them: they count where their evidence is clearly the highest.
    """
    protocol, stated = base.fitted.laxity.protocol, base.fitted.model.knee.uncertainty
    angles = np.unique(protocol.flexion_deg)
    if max(stated.zero_mm, stated.zero_deg) > 0.0 or protocol.n < LEAST_TRIALS * len(angles):
        return None
    if base.fitted.laxity.zero != "absolute":
        return None
    # How strongly the fit favours the errors, in units of its own residuals.
    effect = remounting(angles.tolist())
    fitted, p = base.fitted, effect.parameters
    model = fitted.model.with_effects([*fitted.model.effects, effect])
    jacobian = model.predict_once(np.r_[fitted.theta, p.center]).slopes
    signature = Signature(
        name=effect.name,
        variant="",
        columns=fitted.columns(jacobian[:, :, -p.n :]),
        prior_sd=p.prior_sd,
        sign=np.zeros(p.n, np.int64),
    )
    projector = fitted.scored_projector
    seen = project_signature(projector, signature)
    left = projector.project(fitted.scored_rows)
    left *= np.sqrt(projector.degrees_of_freedom) / np.linalg.norm(left)
    if seen.z_score(seen.gain((left @ seen.projected)[None]))[0] < LEAST_SCORE:
        return None
    explained = refit(base, [effect], [np.r_[base.fitted.theta, effect.parameters.center]])
    return effect if explained.log_evidence > best.log_evidence + FAR_EVIDENCE else None
