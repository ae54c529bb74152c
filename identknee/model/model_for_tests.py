"""The model of a knee under planned or measured tests."""

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee


def model_for_tests(knee: Knee, tests: Protocol | Laxity) -> LaxityModel:
    """The model of a knee under these tests, set up as for a fit to them.

    A knee that states the poses of its fit begins at those, also in measured trials.
    """
    trials = tests.protocol if isinstance(tests, Laxity) else tests
    model = LaxityModel(knee=knee, protocol=trials)
    return model.with_tests(tests) if isinstance(tests, Laxity) and not knee.poses else model
