"""The subject extended by what a diagnosis found, for every other calculation."""

from identknee.diagnosis.refit import Refit
from identknee.model.effects.stored import choice_of
from identknee.subject.knee import Knee


def extended_knee(refit: Refit) -> Knee:
    """The subject whose model has the effects of a fit, each with the amplitudes found.

    Ligaments keep the values that the subject came with: priors are centred on them, and data used
    for both prior and likelihood would count twice. A search starts at the fit with
    `fitted_values`.
    """
    knee = refit.fitted.model.knee
    effects = refit.fitted.model.effects
    return knee.with_effects([choice_of(knee, x, refit.amplitudes(x.name)) for x in effects])


def fitted_values(refit: Refit) -> dict[str, dict[str, float]]:
    """All parameters of a fit by owner and name, as in a file of starts."""
    tree: dict[str, dict[str, float]] = {}
    parameters = refit.fitted.model.parameters.names
    for name, value in zip(parameters, refit.fitted.theta.tolist(), strict=True):
        owner, _, quantity = name.partition(".")
        tree.setdefault(owner, {})[quantity] = value
    return tree
