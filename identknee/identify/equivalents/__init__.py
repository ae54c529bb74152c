"""Parameter sets that a measurement cannot tell apart, as different as they can be."""
