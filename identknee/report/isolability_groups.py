"""What a protocol can tell, as an xarray dataset and as the words of a summary."""

from typing import Any

import numpy as np
import xarray

from identknee.diagnosis.advice.isolability import LEAST_DISTANCE
from identknee.diagnosis.advice.protocol import ROOT, ProtocolIsolability
from identknee.report.diagnosis_summary import trials_summary


def isolability_summary(found: ProtocolIsolability) -> dict[str, Any]:
    """What ``result.json`` says: groups that cannot be told apart, and what every effect shows."""
    return {
        "protocol": found.protocol.name,
        "n_trials": found.protocol.n,
        "groups": [
            {
                "effects": list(x.names),
                "distance": x.before,
                "distance_with_advised_trials": x.after,
                "advised_trials": trials_summary(x.trials),
            }
            for x in found.advice
        ],
        "look_alikes": {name: list(near) for name, near in found.look_alikes.items()},
        "effects": {
            x.name: {
                "parameter": x.parameter,
                "unit": x.unit,
                "detectable": x.detectable,
                "relevant": x.relevant,
                "power": x.power,
            }
            for x in found.visibility
        },
        "root_noncentrality": ROOT,
        "least_distance": LEAST_DISTANCE,
    }


def isolability_groups(found: ProtocolIsolability) -> dict[str, xarray.Dataset]:
    """Group ``isolability``: distances of each effect, if true, from each other one."""
    effects = found.distances.effects
    order = [found.distances.rivals.index(x) for x in effects]
    return {
        "isolability": xarray.Dataset(
            {
                "distance": (("effect", "rival"), np.array(found.distances.values[:, order])),
                "detectable": ("effect", [x.detectable for x in found.visibility]),
                "relevant": ("effect", [x.relevant for x in found.visibility]),
                "power": ("effect", [x.power for x in found.visibility]),
            },
            coords={
                "effect": list(effects),
                "rival": list(effects),
                "unit": ("effect", [x.unit for x in found.visibility]),
            },
        )
    }
