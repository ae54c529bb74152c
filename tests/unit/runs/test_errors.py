import pickle

from identknee.runs.errors import InputError


def test_message_names_file_place_reason_and_remedy() -> None:
    error = InputError(
        "knee/laxity.csv", "row 7, column varus_deg", "it is text", "Write a number."
    )
    assert str(error) == "knee/laxity.csv, row 7, column varus_deg: it is text. Write a number."
    assert isinstance(error, ValueError)


def test_message_without_a_place() -> None:
    assert (
        str(InputError("a.csv", "", "it is empty.", "Export it."))
        == "a.csv: it is empty. Export it."
    )


def test_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(InputError("a.csv", "row 1", "why", "Remedy.")))
    assert str(error) == "a.csv, row 1: why. Remedy."
    assert error.where == "row 1"
