"""The named subjects: knees that come with identknee, each with its source and licence."""

from pathlib import Path

from identknee.runs.declare import declared, entry
from identknee.runs.errors import closest, suggestion
from identknee.runs.files import PathLike

FOLDER = Path(__file__).parent / "knees"
REFERENCE = "reference"


@declared
class NamedSubject:
    """A knee that comes with identknee."""

    name: str = entry("The word that stands for it where a subject folder is wanted")
    file: Path | None = entry("Its subject file; None where closed formulas make it")
    opensim: Path | None = entry(
        "The OpenSim model that it was taken from; None where there is none",
        default=None,
    )
    source: str = entry("Where the knee comes from, as it is to be cited")
    licence: str = entry("Its licence, as an SPDX expression")


_LENHART = (
    "Lenhart et al. 2015, Ann Biomed Eng 43(11):2675-2685, doi:10.1007/s10439-015-1326-3; "
    "geometry of OpenSim JAM"
)
_DENVER = "Andreassen et al., cadaver S192803, Dryad, doi:10.5061/dryad.zkh1893gw"

NAMED_SUBJECTS = (
    NamedSubject(
        name=REFERENCE,
        file=None,
        source="identknee: closed formulas fitted to real cartilage",
        licence="Apache-2.0",
    ),
    NamedSubject(
        name="lenhart2015",
        file=FOLDER / "lenhart2015" / "subject.toml",
        opensim=FOLDER / "lenhart2015" / "opensim" / "lenhart2015.osim",
        source=_LENHART,
        licence="Apache-2.0",
    ),
    NamedSubject(
        name="lenhart2015_stable",
        file=FOLDER / "lenhart2015_stable" / "subject.toml",
        source=f"{_LENHART}; insertions moved by identknee",
        licence="Apache-2.0",
    ),
    NamedSubject(
        name="s192803",
        file=FOLDER / "s192803" / "subject.toml",
        source=_DENVER,
        licence="CC0-1.0",
    ),
    NamedSubject(
        name="s192803_bundles",
        file=FOLDER / "s192803" / "subject_bundles.toml",
        source=_DENVER,
        licence="CC0-1.0",
    ),
)


def named_subject(word: object) -> NamedSubject | None:
    """The subject that this word stands for; None where it stands for none.

    Only text can be a name: a `pathlib.Path` is always a place on the disk.

    Examples
    --------
    >>> named_subject("lenhart2015").licence
    'Apache-2.0'
    >>> named_subject("./lenhart2015") is None
    True
    """
    return next((x for x in NAMED_SUBJECTS if isinstance(word, str) and x.name == word), None)


def opensim_file(path: PathLike) -> Path:
    """The file of a model: the one that comes with identknee where the text is its name.

    Examples
    --------
    >>> opensim_file("lenhart2015").name
    'lenhart2015.osim'
    """
    named = named_subject(path)
    return Path(path) if named is None or named.opensim is None else named.opensim


def known_names(word: str) -> str:
    """Sentences that list the named subjects, the closest to `word` first where one is close.

    Examples
    --------
    >>> known_names("lenhart2051")
    'Did you mean lenhart2015? Named subjects are reference, lenhart2015, lenhart2015_stable, \
s192803, s192803_bundles.'
    """
    names = [x.name for x in NAMED_SUBJECTS]
    listed = f"Named subjects are {', '.join(names)}."
    return f"{suggestion(word, names)} {listed}" if closest(word, names) else listed
