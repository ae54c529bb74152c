"""Figures as the bytes of a picture file."""

import io

from matplotlib.figure import Figure

DOTS_PER_INCH = 150


def png(figure: Figure) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()
