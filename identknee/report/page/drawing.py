"""A figure of the page, with its words."""

from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """A figure with what stands below it and what is said in its place.

    Attributes
    ----------
    name
        Of its file, without an ending.
    figure
        The figure.
    caption
        How to read it.
    description
        What it shows, for those who do not see it.
    """

    name: str
    figure: Figure
    caption: str
    description: str
