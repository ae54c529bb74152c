"""Which causes trials can tell apart, and the trials to add."""
