"""The nouns a user brings: surfaces, frames, ligaments, the knee, and the readers of them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
