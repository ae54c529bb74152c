"""On a knee whose lines are bundles already, more bundles are asked for one ligament at a time."""

import numpy as np
import pytest
from tolerances import SAME_POSE

from identknee.laxity.protocol import load_protocol
from identknee.model.effects.library import choice_of, effect_named, library
from identknee.model.effects.tissues import BUNDLES, LigamentBundles, bundles_of_each
from identknee.model.laxity_model import LaxityModel
from identknee.subject.folder import example
from identknee.subject.knee import Knee

LIGAMENTS = ("ACL", "PCL", "lateral", "medial")
OF_ONE = 7
PROTOCOL = load_protocol("seed63").select([0, 5, 30])


@pytest.fixture(scope="module")
def bundled() -> Knee:
    return example("s192803_bundles")


def test_each_ligament_is_a_cause_of_its_own(bundled: Knee) -> None:
    own = [x for x in library(bundled) if x.name == BUNDLES]
    assert all(isinstance(x, LigamentBundles) for x in own)
    assert tuple(x.ligament for x in bundles_of_each(bundled)) == LIGAMENTS
    assert [x.parameters.n for x in own] == 4 * [OF_ONE]
    assert effect_named(bundled, BUNDLES).parameters.n == 4 * OF_ONE


def test_a_knee_of_single_lines_has_one_for_all(reference: Knee) -> None:
    (own,) = [x for x in library(reference) if x.name == BUNDLES]
    assert own.parameters.n == OF_ONE * len(reference.ligaments)


def test_one_ligament_does_what_all_do_with_the_others_as_they_are(bundled: Knee) -> None:
    one = bundles_of_each(bundled)[1]
    values = np.array([4.0, 2.0, -1.0, 0.5, 1.0, 0.0, -2.0])
    whole = effect_named(bundled, BUNDLES)
    names = [x.removeprefix(f"{BUNDLES}.") for x in one.parameters.names]
    assert all(x.startswith("PCL_") for x in names)
    alone = LaxityModel(knee=bundled, protocol=PROTOCOL, effects=(one,))
    among = LaxityModel(knee=bundled, protocol=PROTOCOL, effects=(whole,))
    theta = among.parameters.vector(
        {f"{BUNDLES}.{x}": y for x, y in zip(names, values, strict=True)}
    )
    found = alone.setting(np.r_[alone.parameters.center[:-OF_ONE], values])
    wanted = among.setting(theta)
    np.testing.assert_allclose(found.lines.femoral, wanted.lines.femoral)
    np.testing.assert_allclose(found.reference_strain, wanted.reference_strain)
    # Both cruciate lines are split, and no other moves.
    plain = LaxityModel(knee=bundled, protocol=PROTOCOL)
    moved = np.abs(found.lines.femoral[:14] - plain.setting(plain.parameters.center).lines.femoral)
    lines = np.array([x.name for x in bundled.ligaments])
    split = tuple(lines[np.asarray(moved.any(axis=1))].tolist())
    assert split == next(x.members for x in bundled.groups if x.name == "PCL")


def test_it_is_stored_with_the_knee_and_only_it_is_calibrated(bundled: Knee) -> None:
    one = bundles_of_each(bundled)[0]
    values = np.array([4.0, 2.0, -1.0, 0.5, 1.0, 0.0, -2.0])
    extended = bundled.with_effects([choice_of(bundled, one, values)])
    model = LaxityModel(knee=extended, protocol=PROTOCOL)
    assert set(one.parameters.names) <= set(model.parameters.names)
    assert not [x for x in model.parameters.names if x.startswith(f"{BUNDLES}.medial")]
    direct = LaxityModel(knee=bundled, protocol=PROTOCOL, effects=(one,))
    theta = direct.parameters.vector(dict(zip(one.parameters.names, values.tolist(), strict=True)))
    n = direct.n_ligament_parameters
    again = model.parameters.vector(dict(zip(one.parameters.names, values.tolist(), strict=True)))
    again[:n] = theta[:n]
    found, wanted = (x.setting(y).lines.femoral for x, y in ((model, again), (direct, theta)))
    np.testing.assert_allclose(found, wanted, atol=SAME_POSE)
