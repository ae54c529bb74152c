"""The posterior: its density, ensembles of walkers, one gate to stop at, a second opinion."""
