"""Power scaling against posteriors whose dependence on the prior is known, and against ArviZ."""

import numpy as np
import pytest
from problems import Linear, plain_parameters

from identknee.identify.posterior.posterior import Posterior, StopRule, prior_sensitivity
from identknee.identify.posterior.sample import sample

QUICK = StopRule(drift=np.inf)


def measured(sd: tuple[float, ...], data: tuple[float, ...]) -> Posterior:
    """Parameters measured directly, each with its noise; the priors are normal (0, 2)."""
    parameters = plain_parameters(len(sd), -50.0, 50.0)
    matrix = np.diag(1.0 / np.array(sd))
    problem = Linear(parameters=parameters, matrix=matrix, data=matrix @ np.array(data))
    return sample(problem, rule=QUICK, seed=1)


def test_what_is_measured_well_leans_on_the_data_and_what_is_not_on_the_prior() -> None:
    # The last one is measured as well as it was known before, and far from where.
    found = prior_sensitivity(measured((0.02, 200.0, 2.0), (0.1, 0.0, 4.0)))
    assert found.verdicts == ("data", "prior", "both")


def test_it_agrees_with_arviz() -> None:
    arviz = pytest.importorskip("arviz")
    # Its newer versions warn where one only asks for the name.
    if "InferenceData" not in vars(arviz):
        pytest.skip("ArviZ 1.x asks for its own container; 0.23 is compared with")
    posterior = measured((0.3, 2.0), (0.1, 1.0))
    n_draws = posterior.kept.shape[2]
    chains = posterior.kept.reshape(-1, n_draws, 2)
    prior = posterior.kept_log_prior.reshape(-1, n_draws)
    likelihood = posterior.kept_log_likelihood.reshape(-1, n_draws)
    data = arviz.from_dict(posterior={"theta": chains}, log_likelihood={"y": likelihood[..., None]})
    data.add_groups({"log_prior": {"theta": prior}}, dims={"theta": []}, coords={})
    found = prior_sensitivity(posterior)
    for component, ours in (("prior", found.prior), ("likelihood", found.likelihood)):
        theirs = arviz.psens(data, component=component)["theta"].to_numpy()
        np.testing.assert_allclose(ours, theirs, rtol=0.02)
