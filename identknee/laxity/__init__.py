"""Laxity protocols and tables, measured or simulated, and their noise."""
