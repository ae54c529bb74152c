"""What a protocol can tell before anything is measured."""

from collections.abc import Sequence

import numpy as np
import pytest
from diagnoses import FRAME, SD, short_trials

from identknee.diagnosis.advice import (
    GroupAdvice,
    ProtocolIsolability,
    protocol_isolability,
)
from identknee.diagnosis.candidates import Variant
from identknee.diagnosis.isolability import ENOUGH, MOST_TRIALS
from identknee.diagnosis.score import LEAST_DISTANCE
from identknee.laxity.protocol import Protocol, concatenate
from identknee.model.effects.library import library
from identknee.subject.knee import Knee


@pytest.fixture(scope="module")
def found(reference: Knee) -> ProtocolIsolability:
    return _found(reference, SD)


def _found(knee: Knee, sd: float) -> ProtocolIsolability:
    made = protocol_isolability(knee, short_trials(), sd_mm=sd, sd_deg=sd)
    assert made is not None
    return made


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups without the search for trials that set them apart, which takes most of the time."""

    def named(_fitted: object, _candidates: object, members: Sequence[Variant]) -> GroupAdvice:
        names = tuple(x.effect.name for x in members)
        return GroupAdvice(names=names, trials=short_trials(), before=0.0, after=0.0)

    monkeypatch.setattr("identknee.diagnosis.advice._advise", named)


@pytest.mark.slow
def test_moment_gains_pass_for_each_other(found: ProtocolIsolability) -> None:
    """Both scale all stiffnesses, so that only contact could tell."""
    assert "moment_gain_VV" in found.look_alikes["moment_gain_IE"]
    assert any({"moment_gain_IE", "moment_gain_VV"} <= set(x) for x in found.groups)


@pytest.mark.slow
def test_trials_advised_set_groups_apart(found: ProtocolIsolability) -> None:
    for group in found.advice:
        assert group.trials.n == MOST_TRIALS or group.after > ENOUGH
        assert group.after > group.before
        assert not set(group.trials.trials) & set(found.protocol.trials)


@pytest.mark.slow
def test_look_alikes_are_near_and_mutual(found: ProtocolIsolability, reference: Knee) -> None:
    assert list(found.look_alikes) == [x.name for x in library(reference)]
    for name, near in found.look_alikes.items():
        assert name not in near
        assert all(name in found.look_alikes[x] for x in near)
    for group in found.groups:
        assert all(set(found.look_alikes[x]) & set(group) for x in group)


@pytest.mark.usefixtures("no_search")
@pytest.mark.slow
def test_less_noise_shows_smaller_effects(found: ProtocolIsolability, reference: Knee) -> None:
    """Little of the noise is roughness of the surfaces, which stays."""
    quieter = {x.name: x.detectable for x in _found(reference, 0.5 * SD).visibility}
    frame = next(x for x in found.visibility if x.name == FRAME)
    assert 0.45 < quieter[FRAME] / frame.detectable < 0.75
    assert LEAST_DISTANCE > 0


@pytest.mark.usefixtures("no_search")
def test_trials_that_the_knee_cannot_bear_are_left_out(
    reference: Knee, found: ProtocolIsolability
) -> None:
    loads = np.zeros((1, 5))
    loads[0, 1] = -50.0
    bent = Protocol(name="bent", trials=("bent",), flexion_deg=np.zeros(1), loads=loads)
    assert protocol_isolability(reference, bent, sd_mm=SD, sd_deg=SD) is None
    both = concatenate([short_trials(), bent])
    kept = protocol_isolability(reference, both, sd_mm=SD, sd_deg=SD)
    assert kept is not None
    assert kept.protocol.trials == short_trials().trials
    assert kept.groups == found.groups
