"""The knees that come with identknee."""

from identknee.laxity.named_tables import TABLES
from identknee.laxity.named_trials import example_laxity
from identknee.runs.declare import declared, derived, entry
from identknee.subject.examples import NAMED_SUBJECTS
from identknee.subject.folder import example


@declared
class NamedSubjectFacts:
    """A knee that comes with identknee."""

    name: str = entry("Word that stands for the knee wherever a subject is wanted")
    side: str = entry("right or left")
    ligaments: tuple[str, ...] = entry("Names of the ligaments")
    source: str = entry("Where the knee comes from, as it is to be cited")
    licence: str = entry("Licence, as an SPDX expression")
    n_measured_trials: int = entry("Trials of measured laxity; 0 without", unit="1")
    has_opensim_model: bool = entry("Whether the OpenSim model of the knee is there too")
    description: str = entry("What the knee is")

    @property
    @derived("Whether the name also stands for a table of measured laxity")
    def has_measured_laxity(self) -> bool:
        """Whether the name also stands for a table of measured laxity."""
        return self.n_measured_trials > 0


@declared
class NamedSubjects:
    """The knees that come with identknee."""

    subjects: tuple[NamedSubjectFacts, ...] = entry("The knees")

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """Each knee with its ligaments and its source."""
        lines = []
        for x in self.subjects:
            n = x.n_measured_trials
            laxity = f"{n} measured trials" if n else "no measured laxity"
            lines += [
                f"{x.name}: {x.side} knee, {laxity}, licence {x.licence}",
                f"  {len(x.ligaments)} ligaments: {', '.join(x.ligaments)}",
                f"  {x.source}",
            ]
        return "\n".join(lines)


def list_subjects() -> NamedSubjects:
    """The knees that come with identknee, with their sources and licences."""
    found = []
    for subject in NAMED_SUBJECTS:
        knee = example(subject.name)
        found.append(
            NamedSubjectFacts(
                name=subject.name,
                side=knee.side,
                ligaments=tuple(x.name for x in knee.ligaments),
                source=subject.source,
                licence=subject.licence,
                n_measured_trials=example_laxity(subject.name).n if subject.name in TABLES else 0,
                has_opensim_model=subject.opensim is not None,
                description=knee.description,
            )
        )
    return NamedSubjects(subjects=tuple(found))
