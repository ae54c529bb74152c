"""What a simulation says: how many trials have an equilibrium, and why the others have none."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import override

from identknee.laxity.protocol import ABSOLUTE, Protocol, from_zero
from identknee.laxity.table import COORDINATES, Laxity
from identknee.report.presenter import Presenter, Question, Statement, table
from identknee.runs.record import Outcome
from identknee.runs.words import amount, label_without_unit, listed, unit_of
from identknee.verbs.answer import Answer
from identknee.verbs.simulate import SimulatedLaxity, Simulation

if TYPE_CHECKING:
    from identknee.report.laxity_figures import LaxityCurves


# Rows of ligaments that a terminal shows.
MOST_LIGAMENTS = 8


def _how_many(answer: Simulation) -> str:
    n, found = answer.n_trials, answer.n_converged
    if n == found:
        return "The one simulated trial has" if n == 1 else f"All {n} simulated trials have"
    return f"Of {n} simulated trials, {found} {'has' if found == 1 else 'have'}"


def simulated_curves(answer: SimulatedLaxity, data: Laxity | None = None) -> "LaxityCurves":
    """The laxity simulated beside data, counted from their zero."""
    from identknee.report.laxity_figures import LaxityCurves

    zero = ABSOLUTE if data is None else data.zero
    return LaxityCurves(
        protocol=answer.protocol,
        simulated={"simulated": from_zero(answer.coordinates, answer.protocol, zero)},
        measured=None if data is None else data.coordinates,
        sd=None if data is None else data.sd,
    )


class SimulationPresenter(Presenter[Simulation]):
    """How a simulation is shown."""

    question = Question.LAXITY

    @override
    def statements(self, answer: Simulation) -> Iterator[Statement]:
        """How many trials have an equilibrium."""
        lost = [x for x in answer.trials if x.outcome is not Outcome.CONVERGED]
        reasons = table(
            "Trials without prediction", ("trial", "why"), ((x.trial, x.reason) for x in lost)
        )
        blank = " The cells of the others are blank." if lost else ""
        # A lost trial has the margin of the pose where its search ended, which no knee can hold.
        # The mesh law has no second derivatives and no margins.
        stable = [x for x in answer.trials if x.outcome is Outcome.CONVERGED]
        margins = [x.margin_N_per_mm for x in stable if np.isfinite(x.margin_N_per_mm)]
        lowest = f" The least stable has a margin of {min(margins):.3g} N/mm." if margins else ""
        yield self.say(
            f"{_how_many(answer)} a stable pose.{blank}{lowest}", *((reasons,) if lost else ())
        )
        if stable:
            yield self._forces(answer)
        if answer.rmse is not None and answer.rmse.n_compared:
            error = answer.rmse
            names = zip(COORDINATES, error.by_coordinate.tolist(), strict=True)
            by_coordinate = table(
                "Error against the measured laxity (root mean square)",
                ("coordinate", ("error", 2), "unit"),
                (
                    (label_without_unit(name), size, unit_of(name))
                    for name, size in names
                    if np.isfinite(size)
                ),
            )
            missing = f"; {error.n_missing} have no prediction" if error.n_missing else ""
            sizes = ((error.mm, "mm"), (error.deg, "deg"))
            errors = [amount(size, unit) for size, unit in sizes if np.isfinite(size)]
            yield self.say(
                f"The prediction is off by {listed(errors)} on average (RMSE over "
                f"{error.n_compared} measured values{missing}).",
                by_coordinate,
            )

    def _forces(self, answer: Simulation) -> Statement:
        """The largest force of each ligament, and where it is."""
        tension, trials = np.nan_to_num(answer.tension_N), answer.protocol.trials
        rows = sorted(
            zip(
                answer.ligaments,
                tension.max(axis=0).tolist(),
                (trials[i] for i in tension.argmax(axis=0)),
                strict=True,
            ),
            key=lambda x: -x[1],
        )
        name, force, trial = rows[0]
        return self.say(
            f"The largest ligament force is {amount(force, 'N')}, of {name} in {trial}.",
            table(
                "Largest ligament forces",
                ("ligament", ("force", 1, "N"), "trial"),
                ((x, y, where if y > 0.0 else "") for x, y, where in rows),
                most=MOST_LIGAMENTS,
            ),
        )

    @override
    def curves(self, answer: Simulation, beside: Sequence[Answer]) -> "LaxityCurves":
        return simulated_curves(answer, answer.noisy)

    @override
    def protocol(self, answer: Simulation) -> Protocol:
        return answer.protocol
