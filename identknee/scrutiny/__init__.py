"""Scrutiny: what speaks against data and fit before physics is asked: conventions, blunders."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
