"""The figures of a tutorial, which are not pyplot's."""

from typing import Any
from weakref import WeakSet

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

_shown: WeakSet[Figure] = WeakSet()


def scraped(_block: object, names: dict[str, Any], gallery: dict[str, Any]) -> str:
    """Directives for the figures that a block of a tutorial has given a name."""
    paths = []
    for value in list(names["example_globals"].values()):
        if isinstance(value, Figure) and value not in _shown:
            _shown.add(value)
            paths.append(next(names["image_path_iterator"]))
            value.savefig(paths[-1], dpi=110)
    return str(figure_rst(paths, gallery["src_dir"]))
