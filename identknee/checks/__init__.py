"""Checks of data, subject and fit before any cause is sought, and the trials a fit can use."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
