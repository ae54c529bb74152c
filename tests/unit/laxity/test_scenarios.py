"""Coordinates of trials are grouped by what they are, where and under which load."""

from identknee.laxity.protocol import load_protocol
from identknee.laxity.trial_words import laxity_groups


def test_groups_name_coordinate_angle_and_load() -> None:
    protocol = load_protocol("seed63")
    names = [x.name for x in laxity_groups(protocol)]
    assert len(names) == 5 * protocol.n
    assert len(set(names)) == 5 * 3 * 5
    assert "internal_deg, 30 deg, external moment" in names
