"""Searches from many starts: where they end, why, and from how far the best fit is found."""
