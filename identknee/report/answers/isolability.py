"""What a protocol could show of causes, before there are data."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from typing_extensions import override

from identknee.diagnosis.candidates import Detectability
from identknee.diagnosis.isolability import Distances
from identknee.model.effects.facts import cause_label
from identknee.report.answers.design import trial_list, trial_table, trials_words
from identknee.report.presenter import Drawing, Presenter, Question, Statement
from identknee.report.tables import table
from identknee.runs.schema import summary_of
from identknee.runs.words import amount, listed, listed_first
from identknee.subject.knee import Knee
from identknee.verbs.isolability import Isolability

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CAUSES = 2
SIZES = ("detectable above", "smallest relevant effect")


def detectable_sizes(x: Detectability) -> tuple[str, str]:
    """The size that nine of ten data sets would show, and the smallest that matters."""
    # Not a number where no plausible size would be seen; infinite in answers of earlier versions.
    seen = amount(x.detectable, x.unit) if x.detectable < float("inf") else "not detectable"
    return seen, amount(x.relevant, x.unit)


def _few(causes: Sequence[str]) -> str:
    """Causes in words, of many the first."""
    return listed_first([cause_label(x) for x in causes], MOST_CAUSES)


class IsolabilityPresenter(Presenter[Isolability]):
    """How it is shown what a protocol could distinguish."""

    question = Question.WRONG

    @override
    def statements(self, answer: Isolability) -> Iterator[Statement]:
        """What a protocol could show, before there are data."""
        rows = tuple(
            (
                cause_label(name),
                *detectable_sizes(x),
                listed(map(cause_label, answer.look_alikes.get(name, ()))) or "-",
            )
            for name, x in answer.effects.items()
        )
        names = ("cause", *SIZES, "looks like")
        shown = table("What these trials could show in nine of ten data sets", names, rows)
        trials = f"The {answer.n_trials} trials of {answer.protocol}"
        together = "; ".join(_few(x.effects) for x in answer.groups)
        outcome = "would distinguish all causes."
        if answer.groups:
            outcome = f"could not distinguish all causes. These are confounded: {together}."
        yield self.say(f"{trials} {outcome}", shown, is_answer=True)
        for group in answer.groups:
            if group.advised_trials:
                n = len(group.advised_trials)
                one = f"One more trial ({trials_words(group.advised_trials)})"
                yield Statement(
                    question=Question.NEXT,
                    sentence=f"{one if n == 1 else f'{n} more trials'} would help to tell "
                    f"{_few(group.effects) if len(answer.groups) > 1 else 'them'} apart. The two "
                    f"closest would then be {group.distance_with_advised_trials:.1f} and not "
                    f"{group.distance:.1f} units of noise apart.",
                    tables=(trial_table(group.advised_trials),),
                )

    @override
    def drawings(self, answer: Isolability, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.diagnosis_figures import isolability_figure

        names = answer.rivals
        yield Drawing(
            name="isolability",
            figure=isolability_figure(
                Distances(effects=names, rivals=names, values=answer.distances)
            ),
            caption="How far the data of each cause (rows) are from what another cause (columns) "
            "could explain in its place. Causes in dark cells cannot be distinguished.",
            description=f"Distances between {len(names)} causes.",
        )

    @override
    def pictures(self, answer: Isolability, knee: Knee) -> dict[str, "Figure"]:
        return {x.name: x.figure for x in self.drawings(answer, "", knee)}

    @override
    def next_tests(self, answer: Isolability) -> Iterator[str]:
        for group in answer.groups:
            if group.advised_trials:
                trials = trial_list([summary_of(x) for x in group.advised_trials])
                causes = listed(map(cause_label, group.effects), "from")
                yield f"{trials}. This would tell {causes}."
