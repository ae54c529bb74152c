import pickle

from identknee.runs.errors import InputError


def test_message_names_file_place_reason_and_remedy() -> None:
    error = InputError(
        "knee/laxity.csv", "row 7, column varus_deg", "it is text", "Write a number."
    )
    assert str(error) == f"{error.path}, {error.where}: {error.why}. {error.remedy}"
    assert isinstance(error, ValueError)


def test_message_without_a_place() -> None:
    assert str(InputError("a.csv", "", "empty.", "")) == "a.csv: empty."


def test_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(InputError("a.csv", "row 1", "why", "Remedy.")))
    assert (error.path, error.where, error.why, error.remedy) == (
        "a.csv",
        "row 1",
        "why",
        "Remedy.",
    )
