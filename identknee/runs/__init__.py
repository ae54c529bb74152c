"""How a computation is run and remembered: outcomes, records, files, executors, progress."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
