"""The set-up of the verbs of identifiability from the words of a command line."""

from collections.abc import Sequence
from dataclasses import dataclass

from identknee.cli.digests import file_digests
from identknee.laxity.named_tables import laxity_file
from identknee.laxity.table import read_laxity
from identknee.runs.files import PathLike, digest
from identknee.subject.folder import read_subject
from identknee.verbs.identification import Identification as SetUp
from identknee.verbs.identification import identification as identified
from identknee.verbs.knee_digest import knee_digest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification(SetUp):
    """A set-up with the digests of what it was read from.

    Attributes
    ----------
    inputs
        SHA-256 of each input by name.
    """

    inputs: dict[str, str]


def identification(
    subject: str,
    data: PathLike,
    *,
    noise: str | None = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    bounds: Sequence[str] | None = None,
) -> Identification:
    """Subject and data, read, checked and compared in units of the noise."""
    laxity, knee = read_laxity(data), read_subject(subject)
    setup = identified(knee, laxity, noise=noise, start=start, fixed=fixed, bounds=bounds)
    inputs = {
        "subject": knee_digest(knee),
        "data": digest(laxity_file(data)),
        **file_digests(start=start),
    }
    fields = {name: getattr(setup, name) for name in SetUp.__slots__}
    return Identification(**fields, inputs=inputs)
