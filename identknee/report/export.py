"""A knee, and what was found of it, in the files of other tools."""

from pathlib import Path

from identknee.runs.files import PathLike
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim_export import write_opensim
from identknee.verbs.files import load
from identknee.verbs.fitted_knee import fitted_knee


def export_knee(
    knee: Knee,
    out: PathLike,
    *,
    fitted: PathLike | None = None,
    osim: bool = False,
    source: PathLike | None = None,
) -> tuple[Knee, tuple[Path, ...]]:
    """The knee written, and the paths of what was written: its folder first.

    Parameters
    ----------
    knee
        The subject.
    out
        The folder, made if it is not there.
    fitted
        A result of `fit`, `profile` or `simulate` of the subject: the knee is written with the
        parameters found there.
    osim
        Whether to write an OpenSim model as well.
    source
        The OpenSim model that the knee was imported from, of which a changed copy is written; it
        stands for `osim` too.

    Raises
    ------
    ValueError
        If a file cannot be used, or the result is of another knee.
    """
    if fitted is not None:
        knee = fitted_knee(knee, load(fitted))
    written = [write_subject(knee, out)]
    if osim or source is not None:
        written.append(write_opensim(knee, out, source=source))
    return knee, tuple(written)
