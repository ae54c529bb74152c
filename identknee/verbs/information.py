"""Which combinations of parameters the data determine around the best fit, and how well."""

from typing import Annotated, Unpack

from identknee.identify.information import (
    Geodesic,
    Information,
    Scaling,
    StructureCheck,
    check_structure,
    geodesics,
)
from identknee.identify.information import information as fisher_information
from identknee.runs.declare import declared, derived, entry
from identknee.verbs import options
from identknee.verbs.answer import Answer, has_priors
from identknee.verbs.identification import identification
from identknee.verbs.marginalise_nuisances import marginalise_nuisances
from identknee.verbs.options import option
from identknee.verbs.verb import Run, verb


@declared
class LocalIdentifiability(Answer):
    """Which combinations of parameters the data determine around the best fit, and how well."""

    fisher: Information = entry(
        "Fisher information at the best fit", group="fisher", is_inline=True
    )
    structure: StructureCheck = entry(
        "Ranks of the sensitivities at random points of the box", group="structure"
    )
    geodesics: tuple[Geodesic, ...] = entry(
        "Straightest paths along the least known combination, and against it",
        rows="geodesic",
        group="geodesics",
    )
    degrees_of_freedom: int | None = entry(
        "Degrees of freedom of the noise estimated from the fit; null where the noise is stated"
    )

    @property
    @derived("Simulations made in all, each with its Jacobian", unit="1")
    def n_simulations(self) -> int:
        paths = sum(x.n_simulations for x in self.geodesics)
        return self.fisher.n_simulations + self.structure.n_points + paths


@verb
def information(
    run: Run,
    subject: options.Subject,
    data: options.Data,
    *,
    scaling: Annotated[
        Scaling,
        option(
            "Scale of the parameters. typical: 3 kN and 2 %. prior: the standard deviations of "
            "the prior."
        ),
    ] = "typical",
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    bounds: options.Bounds = None,
    priors: options.Priors = None,
    discrepancy: options.Discrepancy = "none",
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> LocalIdentifiability:
    """Which combinations of parameters the data determine around the best fit, and how well.

    Gives the eigenvalues of the Fisher information at the best fit, next to the noise of the
    solver. It also gives the rank at random points within the bounds, and shows where the least
    known combination leads. Stated errors of knee and tests are marginalised to first order at the
    best fit.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputable
        If no parameters near the start have a prediction in every measured trial.
    """
    setup = identification(
        subject,
        data,
        noise=noise,
        start=start,
        fixed=fixed,
        bounds=bounds,
        priors=has_priors("information", priors),
        discrepancy=discrepancy,
    )
    run.start_clock()
    setup, fits = marginalise_nuisances(setup, seed=seed, executor=run.executor)
    theta = fits[0].theta[fits[0].parameters.is_of_interest]
    return LocalIdentifiability(
        fisher=fisher_information(setup.problem, theta, scaling=scaling, seed=seed),
        structure=check_structure(setup.problem, seed=seed, executor=run.executor),
        geodesics=geodesics(setup.problem, theta, scaling=scaling),
        degrees_of_freedom=setup.degrees_of_freedom,
        assumptions=setup.assumptions,
        **setup.uncertain_at(theta),
        findings=setup.findings_at(theta, 2.0 * fits[0].objective, fits),
    )
