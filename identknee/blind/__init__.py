"""Laxity with a hidden effect, made by code that shares nothing with the model, and its scoring."""
