"""Trials to add to a protocol: which of them would tell most."""
