"""The errors of measured laxity: how large they are, and how they hang together."""
