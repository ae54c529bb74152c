"""Laxity with a hidden effect, made by code that shares nothing with the model, and its scoring."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
