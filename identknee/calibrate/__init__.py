"""Calibration: an objective, optimizers and the one verb that runs them."""
