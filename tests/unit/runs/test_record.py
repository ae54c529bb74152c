import json
import pickle
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from identknee.runs.record import Record, record


def test_record_holds_the_call_and_its_time() -> None:
    finished = record("fit", {"start": np.array([1.5])}, {"knee": "ab12"}, seed=4).finish()
    values = json.loads(json.dumps(finished.to_dict()))
    assert values["verb"] == "fit"
    assert values["settings"] == {"start": [1.5]}
    assert values["inputs"] == {"knee": "ab12"}
    assert values["seed"] == 4
    assert {"python", "numpy", "scipy"} <= set(values["versions"])
    assert datetime.fromisoformat(values["started"]).utcoffset() is not None
    assert 0 <= values["seconds"] < 60


def test_record_is_read_only_and_travels_between_processes() -> None:
    finished = record("fit", {"a": 1}, {}).finish()
    with pytest.raises(TypeError):
        finished.settings["a"] = 2  # type: ignore[index]
    copy = pickle.loads(pickle.dumps(finished))
    assert isinstance(copy, Record)
    assert copy.to_dict() == finished.to_dict()


def test_settings_are_fixed_when_the_clock_starts() -> None:
    settings = {"out": Path("a")}
    recording = record("fit", settings, {})
    settings["out"] = Path("b")
    assert recording.finish().settings["out"] == "a"
