"""The measured laxity tables that come with identknee, by named subject."""

from identknee.laxity.named_tables import TABLES
from identknee.laxity.table import Laxity, read_laxity
from identknee.runs.errors import suggestion


def example_laxity(name: str) -> Laxity:
    """The measured laxity of a named subject, which comes with identknee.

    Parameters
    ----------
    name
        ``"s192803"``: 25 end points of a robotic knee simulator; ``"s192803_bundles"``, the same
        specimen, has the same table.

    Raises
    ------
    ValueError
        If there is no such table; the message lists them.

    Examples
    --------
    >>> example_laxity("s192803").n
    25
    """
    if name not in TABLES:
        raise ValueError(f"no laxity of {name!r} comes with identknee. {suggestion(name, TABLES)}")
    return read_laxity(name)
