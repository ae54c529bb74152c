"""Figures as the bytes of a picture file."""

import io

import matplotlib as mpl
from matplotlib.figure import Figure

DOTS_PER_INCH = 150


def png(figure: Figure) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()


def vector(figure: Figure, form: str) -> bytes:
    """The figure as ``"svg"`` or ``"pdf"`` for a paper: text stays text."""
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42, "svg.hashsalt": "identknee"}):
        figure.savefig(
            buffer, format=form, metadata={"Date" if form == "svg" else "CreationDate": None}
        )
    return buffer.getvalue()
