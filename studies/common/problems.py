"""The synthetic data that the studies fit: the 63 trials at the paper's reference parameters."""

import identknee as ik

TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.


def model_of(knee: ik.Knee) -> ik.LaxityModel:
    """The model of a knee under the 63 trials."""
    return ik.LaxityModel(knee=knee, protocol=ik.load_protocol("seed63"))


def truth_of(parameters: ik.model.Parameters) -> ik.runs.Array:
    """The parameters that make the data."""
    return ik.calibrate.named_start(TRUTH, parameters)


def exact_problem(model: ik.LaxityModel) -> ik.LaxityResiduals:
    """The trials of a model simulated at the true parameters, without noise, in mm and deg."""
    return ik.LaxityResiduals(model=model, laxity=model.simulate(truth_of(model.parameters)))


def noisy_problem(model: ik.LaxityModel, noise: float, seed: int) -> ik.LaxityResiduals:
    """The same with noise [mm and deg alike], in units of that noise."""
    clean = model.simulate(truth_of(model.parameters))
    noisy = ik.add_noise(clean, sd_mm=noise, sd_deg=noise, seed=seed)
    return ik.LaxityResiduals(model=model, laxity=noisy, weighting="noise")
