"""Parameters of tied bundles."""

from dataclasses import replace

import numpy as np
from small_knee import small_knee, small_protocol

from identknee.model.laxity_model import LaxityModel
from identknee.model.parameter_groups import tied
from identknee.subject.knee import Knee
from identknee.subject.ligament import LigamentGroup


def grouped() -> Knee:
    return replace(small_knee(), groups=(LigamentGroup(name="sides", members=("outer", "inner")),))


def test_a_group_has_the_sum_of_stiffness_and_the_mean_strain() -> None:
    units, (_, _, outer, inner) = tied(grouped()), small_knee().ligaments
    total = outer.stiffness_kN + inner.stiffness_kN
    assert units.names == ("front", "back", "sides")
    assert units.stiffness_kN[2] == total
    mean = (
        outer.stiffness_kN * outer.reference_strain_pct
        + inner.stiffness_kN * inner.reference_strain_pct
    ) / total
    np.testing.assert_allclose(units.reference_strain_pct[2], mean)


def test_at_the_knees_own_values_nothing_changes() -> None:
    alone = LaxityModel(knee=small_knee(), protocol=small_protocol())
    model = LaxityModel(knee=grouped(), protocol=small_protocol())
    assert model.parameters.n == alone.parameters.n - 2
    there = model.predict(model.parameters.start, derivatives=False).coordinates
    expected = alone.predict(alone.parameters.start, derivatives=False).coordinates
    np.testing.assert_allclose(there, expected, rtol=1e-9, atol=1e-9)


def test_members_keep_their_pattern() -> None:
    model = LaxityModel(knee=grouped(), protocol=small_protocol())
    theta = model.parameters.vector({"sides.stiffness_kN": 2.0, "sides.reference_strain_pct": 1.0})
    setting, (_, _, outer, inner) = model.setting(theta), small_knee().ligaments
    np.testing.assert_allclose(
        setting.stiffness[2] / setting.stiffness[3], outer.stiffness_kN / inner.stiffness_kN
    )
    np.testing.assert_allclose(setting.stiffness[2:].sum(), 2000.0)
    np.testing.assert_allclose(
        100.0 * np.diff(setting.reference_strain[2:]),
        inner.reference_strain_pct - outer.reference_strain_pct,
    )


def test_derivatives_agree_with_differences() -> None:
    model = LaxityModel(knee=grouped(), protocol=small_protocol())
    theta = np.array(model.parameters.start)
    jacobian = model.predict(theta).jacobian
    assert jacobian is not None
    for i in range(model.parameters.n):
        step = np.zeros_like(theta)
        step[i] = 1e-5
        high, low = (model.predict(theta + x, derivatives=False) for x in (step, -step))
        difference = (high.coordinates - low.coordinates) / 2e-5
        np.testing.assert_allclose(jacobian[:, :, i], difference, rtol=1e-4, atol=1e-6)


def test_no_member_is_stretched_farther_than_allowed() -> None:
    units = tied(grouped())
    allowed = np.array([3.0, 1.0, -2.0, 4.0])
    least = units.strain_upper_limits(allowed)
    assert np.all(units.strain(least) <= allowed + 1e-12)
    assert np.isclose(units.strain(least)[2:] - allowed[2:], 0.0).any()
