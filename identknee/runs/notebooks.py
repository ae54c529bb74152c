"""How a notebook shows classes of which a higher layer knows what to show."""

import sys
from collections.abc import Callable, Sequence
from typing import Any


def show_in_notebooks(classes: Sequence[tuple[str, str]], shown: Callable[[Any], Any]) -> None:
    """Let a running notebook show these classes, each by its module and its name.

    Without one nothing happens, and nothing is imported before something is displayed.

    Parameters
    ----------
    classes
        Module and name of each.
    shown
        Gives what has a ``text`` and an ``html`` for an object of them.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None:
        return
    formatters = shell.display_formatter.formatters
    for module, name in classes:
        formatters["text/html"].for_type_by_name(module, name, lambda x: shown(x).html)
        formatters["text/plain"].for_type_by_name(
            module, name, lambda x, printer, _cycle: printer.text(shown(x).text)
        )
