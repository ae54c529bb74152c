"""A figure of the page, with its words."""

from typing import TYPE_CHECKING

from identknee.runs.declare import declared, entry

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@declared
class Drawing:
    """A figure with what stands below it and what is said in its place."""

    name: str = entry("Name of its file, without an ending")
    figure: "Figure" = entry("The figure")
    caption: str = entry("How to read it")
    description: str = entry("What it shows, for those who do not see it")
