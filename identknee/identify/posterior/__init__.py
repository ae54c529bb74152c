"""The posterior: density, ensembles of walkers, convergence check, nested sampling."""
