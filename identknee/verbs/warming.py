"""What is done once before any work, and not counted in its time."""

from identknee.laxity.protocol import Protocol
from identknee.model.laxity_model import LaxityModel
from identknee.runs.progress import progress_bar
from identknee.subject.knee import Knee


def warm_up(knee: Knee, protocol: Protocol) -> None:
    """Compile and build the distance field, or load them, so that times taken later exclude it."""
    with progress_bar("preparing, longer the first time after an installation"):
        model = LaxityModel(knee=knee, protocol=protocol.select([0]), effects=())
        model.predict(model.parameters.center)
