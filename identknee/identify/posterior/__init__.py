"""The posterior: density, ensembles of walkers, the check to stop at, a second opinion."""
