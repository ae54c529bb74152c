"""The laxity model: a knee under a protocol, its prediction and exact Jacobian."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
