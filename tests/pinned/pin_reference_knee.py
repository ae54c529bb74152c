"""Record what this program says about the reference knee.

Run as ``python tests/pinned/pin_reference_knee.py``. Beside it, under ``calibration``, stand the
numbers of the throw-away solver that calibrated the knee; they are never recorded again.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from common.published import TABLE2

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import COORDINATES, Laxity, relative_to_unloaded
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction

PATH = Path(__file__).with_name("reference_knee.json")


def numbers(model: LaxityModel, prediction: Prediction) -> dict[str, Any]:
    """Coordinates, tensions, margins and singular values of the 63 trials, and the Table 2 rows."""
    assert prediction.jacobian is not None
    values = np.linalg.svd(prediction.jacobian.reshape(-1, 8), compute_uv=False)
    return {
        "coordinates": prediction.coordinates.tolist(),
        "tensions_N": tensions_of(model, prediction).tolist(),
        "margins_N_per_mm": prediction.margins.tolist(),
        "singular_values": values.tolist(),
        "table2": table2(model),
    }


def table2(model: LaxityModel) -> list[float]:
    """Laxity of each row of the paper's Table 2 [mm or deg], positive the way the load pushes."""
    protocol = load_protocol("table2")
    found = model.with_protocol(protocol).predict(model.parameters.center, derivatives=False)
    laxity = relative_to_unloaded(Laxity(protocol=protocol, coordinates=found.coordinates))
    return [
        float(
            row.sign
            * laxity.coordinates[
                protocol.trials.index(row.trial), COORDINATES.index(row.coordinate)
            ]
        )
        for row in TABLE2
    ]


def main() -> None:
    """Write the numbers into the file, and leave the others in it alone."""
    from identknee.subject.reference import reference_knee

    model = LaxityModel(knee=reference_knee(), protocol=load_protocol("seed63"))
    stored = json.loads(PATH.read_text(encoding="utf-8"))
    stored["program"] = numbers(model, model.predict(model.parameters.center))
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in stored.items()]
    PATH.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
