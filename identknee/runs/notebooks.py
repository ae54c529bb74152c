"""Display in a running notebook: objects of registered classes, and cells that change."""

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
        Returns for an object of these classes something with ``text`` and ``html``.
    """
    shell = _shell()
    if shell is None:
        return
    formatters = shell.display_formatter.formatters
    for module, name in classes:
        formatters["text/html"].for_type_by_name(module, name, lambda x: shown(x).html)
        formatters["text/plain"].for_type_by_name(
            module, name, lambda x, printer, _cycle: printer.text(shown(x).text)
        )


def is_notebook() -> bool:
    """Whether a kernel runs this, whose cells show HTML; a terminal with IPython is none."""
    return getattr(_shell(), "kernel", None) is not None


def shown_in_cell(html: str, text: str) -> Callable[[str, str], None]:
    """A function to call with other HTML and text, which take the place of these in the cell."""
    from IPython import display as cells

    display: Any = cells.display
    handle = display(_bundle(html, text), raw=True, display_id=True)

    def change(new_html: str, new_text: str) -> None:
        handle.update(_bundle(new_html, new_text), raw=True)

    return change


def _bundle(html: str, text: str) -> dict[str, str]:
    return {"text/html": html, "text/plain": text}


def _shell() -> Any:
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
