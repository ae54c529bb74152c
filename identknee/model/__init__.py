"""The laxity model: a knee under a protocol, its prediction and exact Jacobian."""
