"""What the demo says: a good fit with wrong parameters, and within what limits they are known."""

from collections.abc import Iterator, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from typing_extensions import override

from identknee.laxity.protocol import Protocol
from identknee.report.answers.profile import parameter_statements, profile_drawings, profile_range
from identknee.report.answers.simulate import simulated_curves
from identknee.report.presenter import Drawing, Presenter, Question, Range, Statement, table
from identknee.runs.words import listed
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.demo import Demonstration, StartFits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from identknee.report.laxity_figures import LaxityCurves

ENDS = {
    "minimum": "at a minimum",
    "valley": "in a valley",
    "cliff": "at a cliff",
    "budget": "out of budget",
    "spread": "by the stopping rule",
    "start_failed": "no prediction at the start",
}
# Below this a parameter error is rounding [kN].
EXACT_KN = 1e-6


def misleading_fit_sentence(fits: StartFits) -> str:
    """How wrong the parameters of a start were that fitted well."""
    error, rmse = fits.error, fits.rmse
    return (
        "A good fit does not show that its parameters are right. From the start "
        f"{fits.start} the Complex method reproduces the laxity to {rmse['mm']:.2f} mm and "
        f"{rmse['deg']:.2f} deg with parameters that are wrong by {error['kN']:.2f} kN and "
        f"{error['pct']:.2f} % on average."
    )


def least_squares_sentence(fits: Sequence[StartFits]) -> str:
    """How near least squares came from the same starts."""
    largest = max(x.error["kN"] for x in fits)
    if largest > EXACT_KN:
        return f"Least squares ends up to {largest:.2g} kN from the true parameters."
    return (
        f"Least squares with exact derivatives finds the true parameters from all {len(fits)} "
        "starts, so the wrong sets are places where the Complex method stopped, not other minima."
    )


class DemonstrationPresenter(Presenter[Demonstration]):
    """How the demo is shown."""

    questions = MappingProxyType({"starts": Question.SEARCH})

    @override
    def statements(self, answer: Demonstration) -> Iterator[Statement]:
        """What the paper's question comes to: a good fit, wrong parameters, and why."""
        searches = [x for x in answer.starts if x.method == "complex"]
        descents = [x for x in answer.starts if x.method == "least-squares"]
        worst = max(searches, key=lambda x: x.error["kN"])
        rows = tuple(
            (
                f"{x.method.capitalize()} from {x.start}",
                x.error["kN"],
                x.error["pct"],
                x.rmse["mm"],
                x.rmse["deg"],
                int(x.n_simulations),
                ", ".join(f"{n} {ENDS[end]}" for end, n in x.outcomes.items()),
            )
            for x in answer.starts
        )
        yield Statement(
            question=Question.SEARCH,
            sentence=f"{misleading_fit_sentence(worst)} {least_squares_sentence(descents)}",
            tables=(
                table(
                    "Fits of noise-free laxity, medians over the runs",
                    (
                        "method and start",
                        ("mean error of stiffness", 2, "kN"),
                        ("mean error of reference strain", 2, "%"),
                        ("laxity RMSE", 2, "mm"),
                        ("laxity RMSE", 2, "deg"),
                        "simulations",
                        "runs ended",
                    ),
                    rows,
                ),
            ),
            is_answer=True,
        )
        mm, deg = answer.noise["mm"], answer.noise["deg"]
        given = f"With noise of {mm:g} mm and {deg:g} deg, "
        yield from parameter_statements(tuple(answer.profiles.values()), given)

    @override
    def drawings(self, answer: Demonstration, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.sweep_figures import starts_figure

        methods = listed(dict.fromkeys(x.method for x in answer.starts))
        yield Drawing(
            name="starts",
            figure=starts_figure(answer.starts),
            caption="Left: the error of the fitted stiffnesses. Right: how well the same fits "
            "reproduce the laxity. Each dot is one run.",
            description=f"Errors of fits by {methods} from every start. Laxity is reproduced to "
            f"{max(x.rmse_deg.max() for x in answer.starts):.2f} deg at worst, with stiffnesses up "
            f"to {max(x.error_kN.max() for x in answer.starts):.2f} kN wrong on average.",
        )
        truth = {f"{x}.{k}": v for x, own in answer.truth.items() for k, v in own.items()}
        yield from profile_drawings(tuple(answer.profiles.values()), truth)

    @override
    def curves(self, answer: Demonstration, beside: Sequence[Answer]) -> "LaxityCurves":
        return simulated_curves(answer)

    @override
    def pictures(self, answer: Demonstration, knee: Knee) -> dict[str, "Figure"]:
        from identknee.report.parameter_figures import profiles_figure
        from identknee.report.scene import scene
        from identknee.report.sweep_figures import starts_figure

        return {
            "starts": starts_figure(answer.starts),
            "profiles": profiles_figure(tuple(answer.profiles.values())),
            "knee": scene(knee),
        }

    @override
    def ranges(self, answer: Demonstration) -> Iterator[tuple[str, Range]]:
        yield from ((x.name, profile_range(x)) for x in answer.profiles.values())

    @override
    def headline(self, answer: Demonstration) -> str:
        return next(self.statements(answer)).sentence

    @override
    def protocol(self, answer: Demonstration) -> Protocol:
        return answer.protocol
