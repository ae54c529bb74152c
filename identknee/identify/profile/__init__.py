"""Profile likelihoods: what each parameter or prediction may be, and which ends are open."""
