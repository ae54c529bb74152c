"""What a fitted model gets wrong, its cause named or honestly not, and what naming it gains."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
