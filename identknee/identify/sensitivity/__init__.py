"""Global sensitivity of outputs to parameters, over a box or over a posterior."""
