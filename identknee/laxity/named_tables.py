"""Where the measured laxity tables that come with identknee are kept."""

from pathlib import Path

from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike

FOLDER = Path(__file__).parent / "measured"
# By named subject; the specimen has one table whichever lines of action stand for its ligaments.
TABLES = {"s192803": FOLDER / "s192803.csv", "s192803_bundles": FOLDER / "s192803.csv"}


def laxity_file(path: PathLike) -> Path:
    """The file of a table: the one that comes with identknee where the text is a subject's name.

    Only text can be a name: a `pathlib.Path` is always a place on the disk.

    Raises
    ------
    InputError
        If the text reads like a name, and there is neither such a table nor such a file.

    Examples
    --------
    >>> laxity_file("s192803").name
    's192803.csv'
    >>> laxity_file("./mine.csv").name
    'mine.csv'
    """
    if isinstance(path, str) and path in TABLES:
        return TABLES[path]
    file = Path(path)
    if path == file.name and not file.suffix and not file.exists():
        raise InputError(
            path,
            "",
            "there is no such file, and no laxity of this name comes with identknee",
            f"{suggestion(path, TABLES)} Or give the path of a table.",
        )
    return file
