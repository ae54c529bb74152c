"""Tables, figures, result files and the page; the only package that draws.

Called as ``identknee.report(results, path)`` it writes the page of answers, or of the folders that
verbs left.
"""

import sys
from types import ModuleType
from typing import Any

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)


class _Callable(ModuleType):
    """A package that is a verb too."""

    def __call__(self, results: Any, path: Any, *, knee: Any = None) -> Any:
        """The page written from results; see `identknee.report.write_report.report_on`."""
        from identknee.report.write_report import report_on

        return report_on(results, path, knee=knee)


sys.modules[__name__].__class__ = _Callable
