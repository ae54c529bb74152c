"""What figures are drawn on: paper of their own, or axes and subfigures of a user's figure."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as OwnFigure
from matplotlib.figure import FigureBase
from typing_extensions import override

# Text of a vector figure stays text, for those who edit it.
AS_TEXT: dict[Any, Any] = {"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42}
SEVERAL = (
    "it has several panels, which do not fit into one axes; give ax=figure.subfigures() of a "
    'figure with layout="constrained", or no ax'
)


class SeveralPanelsError(ValueError):
    """A figure of several panels was to be drawn on one axes."""

    def __init__(self) -> None:
        super().__init__(SEVERAL)


Place = Axes | FigureBase
_place: ContextVar[Place | None] = ContextVar("place", default=None)


@contextmanager
def drawn_on(place: Place | None) -> Iterator[None]:
    """Figures that are made meanwhile are drawn on this axes or figure."""
    token = _place.set(place)
    try:
        yield
    finally:
        _place.reset(token)


class Paper(OwnFigure):
    """A figure, or what `drawn_on` says in its place."""

    def __new__(cls, *_args: Any, **_how: Any) -> "Paper":
        """A new figure; of a subfigure, or a whole figure given, that one."""
        place = _place.get()
        if isinstance(place, FigureBase):
            return place  # type: ignore[return-value]
        return super().__new__(cls)

    def __init__(self, *args: Any, **how: Any) -> None:
        place = _place.get()
        self._given = place if isinstance(place, Axes) else None
        super().__init__(*args, **how)

    @override
    def subplots(self, nrows: int = 1, ncols: int = 1, **how: Any) -> Any:
        """The panels; the axes given, where there is one."""
        if self._given is None:
            return super().subplots(nrows, ncols, **how)
        if nrows * ncols != 1:
            raise SeveralPanelsError
        return self._given if how.get("squeeze", True) else np.array([[self._given]])

    @override
    def add_subplot(self, *args: Any, **how: Any) -> Any:
        """A panel; the axes given, where there is one."""
        return super().add_subplot(*args, **how) if self._given is None else self._given

    @override
    def add_gridspec(self, *args: Any, **how: Any) -> Any:
        """Places of several panels, which axes given do not have."""
        if self._given is not None:
            raise SeveralPanelsError
        return super().add_gridspec(*args, **how)

    @override
    def legend(self, *args: Any, **how: Any) -> Any:
        """A legend beside the panels; within the axes given, where there is one."""
        if self._given is None:
            return super().legend(*args, **how)
        how.pop("loc", None)
        return self._given.legend(*args, **{**how, "ncols": 1})

    @override
    def suptitle(self, t: str, **how: Any) -> Any:
        """The title of all panels; that of the axes given, where there is one."""
        return (
            super().suptitle(t, **how) if self._given is None else self._given.set_title(t, **how)
        )

    @override
    def colorbar(self, mappable: Any, *args: Any, **how: Any) -> Any:
        """A bar of colours, on the figure that the axes given belong to."""
        if self._given is None:
            return super().colorbar(mappable, *args, **how)
        whole = self._given.get_figure()
        assert whole is not None
        return whole.colorbar(mappable, *args, **how)

    @override
    def savefig(self, fname: Any, **how: Any) -> None:
        """Write the figure; in SVG and PDF its text stays text."""
        with mpl.rc_context(AS_TEXT):
            super().savefig(fname, **how)


# What figures are made of; for those who read types it is any figure.
if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure
else:
    Figure = Paper
