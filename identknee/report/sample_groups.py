"""A sample of the posterior as xarray datasets, under ArviZ's group names, and as a summary."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray

from identknee.identify.posterior.posterior import QUANTILES, Posterior
from identknee.identify.posterior.power_scaling import PriorSensitivity
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.tensions import tensions_of
from identknee.report.groups import constant_data, observed_data
from identknee.runs.arrays import Array

N_PREDICTIONS = 400
CHAIN = ("chain", "draw")


def sample_groups(posterior: Posterior) -> dict[str, xarray.Dataset]:
    """Groups posterior, sample_stats, log_likelihood, log_prior, prior, and latest.

    A chain is a walker and its draws are the steps after burn-in, as ArviZ has it for ensembles;
    the coordinates ``ensemble`` and ``walker`` say which. ArviZ's own R-hat and effective draws
    then count walkers as independent; those of the convergence check do not. Group ``gate`` holds
    the numbers of every check.
    """
    names = list(posterior.parameters.names)
    groups = {"prior": _prior(posterior), "gate": _gate(posterior)}
    if not posterior.checks:
        return groups
    n_ensembles, n_walkers, n_steps = posterior.kept.shape[:3]
    number = np.arange(n_ensembles * n_walkers)
    coordinates = {
        "chain": number,
        "draw": np.arange(n_steps),
        "ensemble": ("chain", number // n_walkers),
        "walker": ("chain", number % n_walkers),
    }
    theta = posterior.kept.reshape(-1, n_steps, len(names))
    likelihood = posterior.kept_log_likelihood.reshape(-1, n_steps)
    prior = posterior.kept_log_prior.reshape(-1, n_steps)
    acceptance = posterior.last_check.acceptance.ravel()
    variables: dict[str, dict[str, Any]] = {
        "posterior": {"theta": ((*CHAIN, "parameter"), theta)},
        "sample_stats": {
            "lp": (CHAIN, likelihood + prior),
            "acceptance_rate": ("chain", acceptance),
        },
        "log_likelihood": {"laxity": (CHAIN, likelihood)},
        "log_prior": {"theta": (CHAIN, prior)},
    }
    whole = {
        name: xarray.Dataset(
            values,
            coords=coordinates | ({"parameter": names} if name == "posterior" else {}),
            attrs={"sample_dims": list(CHAIN), "outcome": posterior.outcome.value},
        )
        for name, values in variables.items()
    }
    return whole | groups


def predictive_groups(
    posterior: Posterior,
    model: LaxityModel,
    laxity: Laxity,
    *,
    whole: Callable[[Array], Array] = np.asarray,
    n_draws: int = N_PREDICTIONS,
) -> dict[str, xarray.Dataset]:
    """Groups ``posterior_predictive``, ``observed_data`` and ``constant_data``.

    The predictions are those of the model, without noise: laxity and the tension of every ligament
    in every trial, for draws as good as independent; fewer than asked for where the sample holds
    fewer.

    Parameters
    ----------
    posterior
        The sample.
    model
        The model, under any protocol: also one that was not measured.
    laxity
        What was measured.
    whole
        Theta of the model from that of the sample, where some parameters were fixed.
    n_draws
        How many draws to predict at.
    """
    places = posterior.independent(n_draws, or_fewer=True)
    thetas = whole(posterior.kept[tuple(places.T)])
    predictions = [model.predict(theta, derivatives=False) for theta in thetas]
    protocol = model.protocol
    predictive = xarray.Dataset(
        {
            "coordinates": (
                (*CHAIN, "trial", "coordinate"),
                np.array([[x.coordinates for x in predictions]]),
            ),
            "tension_N": (
                (*CHAIN, "trial", "ligament"),
                np.array([[tensions_of(model, x) for x in predictions]]),
            ),
        },
        coords={
            "chain": [0],
            "draw": np.arange(len(predictions)),
            "trial": list(protocol.trials),
            "coordinate": list(COORDINATES),
            "ligament": [x.name for x in model.knee.ligaments],
            "ensemble": ("draw", places[:, 0]),
            "walker": ("draw", places[:, 1]),
            "step": ("draw", places[:, 2]),
        },
        attrs={"noise": "none: predictions of the model"},
    )
    return {
        "posterior_predictive": predictive,
        "observed_data": observed_data(laxity),
        "constant_data": constant_data(protocol),
    }


def sample_summary(
    posterior: Posterior, sensitivity: PriorSensitivity | None = None
) -> dict[str, Any]:
    """What ``result.json`` says of a sample."""
    summary: dict[str, Any] = {
        "outcome": posterior.outcome.value,
        "sentence": posterior.outcome.sentence,
        "n_simulations": posterior.n_simulations,
        "seed": posterior.seed,
        "excluded_prior": _fields(posterior.excluded),
        "optima": posterior.optima,
    }
    if not posterior.checks:
        return {**summary, "rhat_max": None, "ess_min": None, "parameters": {}}
    latest = posterior.last_check
    conditions = latest.conditions
    return {
        **summary,
        "rhat_max": conditions["rhat"][0],
        "ess_min": conditions["effective_draws"][0],
        "gate": {
            name: {"value": value, "bar": bar, "met": met}
            for name, (value, bar, met) in conditions.items()
        },
        "steps": latest.steps,
        "burn_in": latest.burn_in,
        "acceptance": {"mean": latest.acceptance.mean(), "lowest": latest.acceptance.min()},
        "stuck_walkers": np.argwhere(latest.stuck),
        "parameters": _parameters(posterior, sensitivity),
    }


def _parameters(
    posterior: Posterior, sensitivity: PriorSensitivity | None
) -> dict[str, dict[str, Any]]:
    latest = posterior.last_check
    quantiles, errors = posterior.quantiles(), posterior.quantile_errors()
    found: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(posterior.parameters.names):
        found[name] = {
            "mean": posterior.mean[i],
            "sd": posterior.sd[i],
            **_by_quantile("q", quantiles[i]),
            "mcse_mean": latest.mean_error[i] * posterior.sd[i],
            **_by_quantile("mcse_q", errors[i]),
            "tau": latest.tau[i],
            "rhat": latest.rhat[i],
            "ess_bulk": latest.bulk[i].sum(),
            "ess_tail": latest.tail[i].sum(),
        }
        if sensitivity is not None:
            found[name] |= {
                "prior_sensitivity": sensitivity.prior[i],
                "likelihood_sensitivity": sensitivity.likelihood[i],
                "leans_on": sensitivity.verdicts[i],
            }
    return found


def _by_quantile(prefix: str, values: Array) -> Mapping[str, float]:
    """By name as in ``q025``: three digits of the probability."""
    names = [f"{prefix}{round(1000 * p):03d}" for p in QUANTILES]
    return dict(zip(names, values.tolist(), strict=True))


def _fields(of: Any) -> dict[str, Any]:
    return {name: getattr(of, name) for name in of.__slots__}


def _prior(posterior: Posterior) -> xarray.Dataset:
    return xarray.Dataset(
        {"theta": ((*CHAIN, "parameter"), posterior.prior[None])},
        coords={
            "chain": [0],
            "draw": np.arange(len(posterior.prior)),
            "parameter": list(posterior.parameters.names),
        },
    )


def _gate(posterior: Posterior) -> xarray.Dataset:
    names = list(posterior.parameters.names)
    checks = posterior.checks
    shape = (len(checks), len(names))
    by_parameter = {
        "tau": [x.tau for x in checks],
        "rhat": [x.rhat for x in checks],
        "ess_bulk": [x.bulk.sum(axis=1) for x in checks],
        "ess_tail": [x.tail.sum(axis=1) for x in checks],
        "mcse_mean_over_sd": [x.mean_error for x in checks],
    }
    return xarray.Dataset(
        {
            **{
                name: (("check", "parameter"), np.array(values, float).reshape(shape))
                for name, values in by_parameter.items()
            },
            "steps": ("check", np.array([x.steps for x in checks], int)),
            "burn_in": ("check", np.array([x.burn_in for x in checks], int)),
            "tau_drift": ("check", np.array([x.drift for x in checks], float)),
            "lowest_acceptance": ("check", np.array([x.acceptance.min() for x in checks], float)),
        },
        coords={"check": np.arange(len(checks)), "parameter": names},
        attrs={"outcome": posterior.outcome.value, "sentence": posterior.outcome.sentence},
    )
