"""`identknee subject list`: the knees that come with identknee."""

import identknee as ik
from identknee.cli.command import Json, print_result


def list_all(as_json: Json = False) -> None:
    """List the subjects that come with identknee.

    Sources and licences stand with each. Use a name wherever a command wants SUBJECT. A subject
    with measured laxity also stands for its DATA.csv.
    """
    print_result(
        ik.verbs.list_subjects(),
        "Next: identknee subject check NAME, or identknee simulate NAME",
        as_json=as_json,
    )
