"""Profile likelihoods of parameters and predictions."""
