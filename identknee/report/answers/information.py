"""What the Fisher information says: which combinations of parameters are known, and how well."""

from collections.abc import Iterator, Sequence

import numpy as np
from typing_extensions import override

from identknee.identify.information import Boundary, shares
from identknee.report.presenter import SDS_95, Drawing, Presenter, Range, Source, Statement, table
from identknee.runs.declare import Array
from identknee.runs.words import label, label_without_unit, listed, parameter_words
from identknee.subject.knee import Knee
from identknee.verbs.information import LocalIdentifiability


def _end(boundary: Boundary, involved: Sequence[str]) -> str:
    """What ended a path, as the end of a sentence."""
    words = listed(map(parameter_words, involved))
    s = "s" if len(involved) == 1 else ""
    return {
        Boundary.NO_INFLUENCE: f"where {words} no longer change{s} any prediction, as where a "
        "ligament is slack",
        Boundary.ZERO: f"where {words} reach{s and 'es'} zero",
        Boundary.BOUND: f"where {words} reach{s and 'es'} a bound",
        Boundary.STANDSTILL: f"where predictions stop changing along {words}",
        Boundary.INFINITY: f"nowhere: {words} go{s and 'es'} on without end, and the predictions "
        "keep changing",
        Boundary.CLIFF: f"at {words}: beyond this point the model has no prediction",
        Boundary.BUDGET: f"at {words}, because the budget of simulations was exhausted",
    }[boundary]


def _combination_words(names: Sequence[str], direction: Array) -> str:
    named = (f"{x:+.2f} {label_without_unit(name)}" for name, x in shares(names, direction))
    # Behind a comma the minus has the width of the plus.
    return ", ".join(named).replace(", -", ", \u2212")


SCALES = {"typical": "typical steps (3 kN and 2 %)", "prior": "prior standard deviations"}
TRANSTRUM = "Transtrum et al. (2011), Phys. Rev. E 83, 036701, doi:10.1103/PhysRevE.83.036701"


class InformationPresenter(Presenter[LocalIdentifiability]):
    """How the information around the best fit is shown."""

    # As of a sample.
    is_folded = True

    @override
    def statements(self, answer: LocalIdentifiability) -> Iterator[Statement]:
        """Whether data could determine every parameter, how well these do, and what they leave."""
        found, structure = answer.fisher, answer.structure
        n = len(found.parameter_names)
        alike = ""
        if n > 1:
            pair = found.most_collinear[0]
            words = listed(map(parameter_words, pair.parameters))
            alike = f" Hardest to separate are {words} (collinearity {pair.collinearity:.3g})."
        yield self.say(
            f"{structure.sentence} The rank is {max(structure.rank, 0)} of {n}. "
            f"Of {structure.n_points} random parameter sets, {structure.n_with_prediction} have a "
            "prediction."
            f"{alike}"
        )
        yield self.say(
            f"{found.n_above_noise} of {n} combinations of parameters exceed the noise of the "
            "solver"
            f". Their condition number is {found.condition:.3g}.",
            table(
                "Combinations of parameters, from well to poorly determined",
                ("combination, in scaled units", ("eigenvalue", None), ("noise floor", None)),
                (
                    (_combination_words(found.parameter_names, direction), x.value, x.floor)
                    for x, direction in zip(found.spectrum, found.eigenvectors.T, strict=True)
                ),
            ),
        )
        yield self.say(
            "These standard deviations linearise the model at the best fit; profiles do not.",
            table(
                "Parameters around the best fit",
                ("parameter", ("best", None), ("sd", None)),
                (
                    (label(name), float(best), float(sd))
                    for name, best, sd in zip(
                        found.parameter_names, found.theta, found.sd, strict=True
                    )
                ),
            ),
        )
        for path in answer.geodesics:
            yield self.say(
                "The geodesic along the least-determined combination ends "
                f"{_end(path.boundary, path.involved)}."
            )

    @override
    def drawings(
        self, answer: LocalIdentifiability, subject: str, knee: Knee | None
    ) -> Iterator[Drawing]:
        from identknee.report.parameter_figures import eigenvectors_figure, spectrum_figure

        found = answer.fisher
        yield Drawing(
            name="spectrum",
            figure=spectrum_figure({subject: found}),
            caption="How well the data determine each combination of parameters, from stiff to "
            "sloppy. A bar marks what rounding alone would give.",
            description=f"Eigenvalues of the information from {found.eigenvalues[0]:.3g} to "
            f"{found.eigenvalues[-1]:.3g}; {found.n_above_noise} of {found.theta.size} stand above "
            "the solver's noise.",
        )
        yield Drawing(
            name="eigenvectors",
            figure=eigenvectors_figure(found),
            caption="Which parameters make up each of these combinations, one column each.",
            description=f"The sloppiest combination is {found.combination(found.theta.size - 1)}.",
        )

    @override
    def method(self, answer: LocalIdentifiability) -> Iterator[str]:
        found = answer.fisher
        yield (
            "The Fisher information was computed at the best fit, with parameters in units of "
            f"their {SCALES[found.scaling]}."
        )
        yield "Standard deviations linearise the model there."
        yield f"The rank was taken at {answer.structure.n_points} random points of the bounds."

    @override
    def sources(self, answer: LocalIdentifiability) -> tuple[str, ...]:
        return (TRANSTRUM,) if answer.geodesics else ()

    @override
    def ranges(self, answer: LocalIdentifiability) -> Iterator[tuple[str, Range]]:
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
