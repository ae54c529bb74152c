"""`identknee subject list`: the knees that come with identknee."""

from typing import Any

import identknee as ik
from identknee.cli.command import Json, show
from identknee.laxity.named_tables import TABLES
from identknee.subject.examples import NAMED_SUBJECTS, NamedSubject


def list_subjects(as_json: Json = False) -> None:
    """List the subjects that come with identknee, with their sources and licences.

    Use a name wherever a command wants SUBJECT. A subject with measured laxity also stands for
    its DATA.csv.
    """
    subjects = [_facts(x) for x in NAMED_SUBJECTS]
    lines = [line for x in subjects for line in _lines(x)]
    lines.append("Next: identknee subject check NAME, or identknee simulate NAME")
    show({"subjects": subjects}, lines, as_json=as_json)


def _facts(subject: NamedSubject) -> dict[str, Any]:
    knee = ik.example(subject.name)
    has_laxity = subject.name in TABLES
    return {
        "name": subject.name,
        "side": knee.side,
        "ligaments": [x.name for x in knee.ligaments],
        "source": subject.source,
        "licence": subject.licence,
        "has_measured_laxity": has_laxity,
        "n_measured_trials": ik.example_laxity(subject.name).n if has_laxity else 0,
        "has_opensim_model": subject.opensim is not None,
        "description": knee.description,
    }


def _lines(facts: dict[str, Any]) -> list[str]:
    trials = facts["n_measured_trials"]
    laxity = f"{trials} measured trials" if trials else "no measured laxity"
    ligaments = facts["ligaments"]
    return [
        f"{facts['name']}: {facts['side']} knee, {laxity}, licence {facts['licence']}",
        f"  {len(ligaments)} ligaments: {', '.join(ligaments)}",
        f"  {facts['source']}",
    ]
