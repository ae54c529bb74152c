"""Knee ligament calibrations, and how far they can be trusted.

The names of the stub beside this file are what most work needs, in the order of the flow: a
subject, its laxity, the model of it, the fit, what is known, what is wrong, the report. The rest is
in the packages, such as ``ik.identify.geodesics``; each has a stub that says where its names come
from. A name is loaded when it is first used, so that ``identknee --help`` waits for no compiler.
"""

from lazy_loader import attach_stub

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
