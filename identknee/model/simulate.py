"""The laxity of a knee under a protocol, in one call."""

from collections.abc import Mapping
from dataclasses import dataclass

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.mechanics.load_paths import Continuation
from identknee.model.laxity_model import Contact, LaxityModel
from identknee.model.prediction import Prediction
from identknee.subject.knee import Knee


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulation:
    """A simulated laxity test.

    Attributes
    ----------
    model
        The knee under its protocol.
    prediction
        Poses, outcomes and stability margins of the trials.
    """

    model: LaxityModel
    prediction: Prediction

    @property
    def laxity(self) -> Laxity:
        """The laxity table; trials that did not converge are blank."""
        return Laxity(protocol=self.model.protocol, coordinates=self.prediction.coordinates)

    @property
    def reasons(self) -> tuple[str, ...]:
        """How each trial ended, as sentences."""
        return tuple(
            outcome.sentence
            if converged
            else f"{outcome.sentence} {100 * reached:.0f} % of the last load step was reached."
            for outcome, converged, reached in zip(
                self.prediction.outcomes,
                self.prediction.is_converged,
                self.prediction.reached,
                strict=True,
            )
        )


def simulate(
    knee: Knee,
    protocol: Protocol,
    values: Mapping[str, float] | None = None,
    *,
    continuation: Continuation = "continuation",
    contact: Contact = "field",
) -> Simulation:
    """The simulated laxity of a knee, with parameters by name and the subject's own for the rest.

    Parameters
    ----------
    knee, protocol
        The subject and its trials.
    values
        For example ``{"ACL.stiffness_kN": 9.5}``.
    continuation, contact
        As in `LaxityModel`.

    Raises
    ------
    ValueError
        If a name is no parameter's or a value is out of range. A trial without equilibrium is not
        an error: it has an outcome.
    """
    model = LaxityModel(knee=knee, protocol=protocol, continuation=continuation, contact=contact)
    theta = model.parameters.vector(values or {})
    return Simulation(model=model, prediction=model.predict(theta, derivatives=False))
