"""Fits with and without causes, the best explanation of a misfit and its rivals."""
