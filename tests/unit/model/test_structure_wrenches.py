"""Wrenches of ligaments, groups and added structures: slopes, sums, and what is cut."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bundled_knee import bundled_knee
from few_places import few_places
from slow_cases import some_slow

import identknee as ik
from identknee.laxity.protocol import Protocol
from identknee.model.effects.library import effect_named
from identknee.model.force_residuals import StructureWrenches, structure_wrenches
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_values
from identknee.runs.declare import Array
from identknee.subject.knee import Uncertainty

EVERYTHING = Uncertainty(
    insertions_mm=2.0,
    registration_deg=2.0,
    registration_mm=2.0,
    load_axes_deg=2.0,
    load_gain=0.05,
    flexion_deg=1.0,
    contact_modulus=0.3,
    contact_exponent=0.2,
    toe_region=0.3,
    reference_pose_deg=1.0,
    reference_pose_mm=1.0,
)
STEP, SHARE = 1e-4, 1e-6
ROWS = (0, 1, 1), ("ACL", "MCL", "LCL")


def _protocol() -> Protocol:
    return ik.load_protocol("table2").select([2, 3])


def _grouped() -> LaxityModel:
    """Bundles, split ligaments and everything uncertain; half of the LCL is cut in the second."""
    knee = bundled_knee().with_uncertainty(EVERYTHING)
    protocol = replace(_protocol(), state=("intact", "cut: LCL 50%"))
    return LaxityModel(knee=knee, protocol=protocol)


def _with_structures() -> LaxityModel:
    knee = ik.reference_knee().with_uncertainty(EVERYTHING)
    model = LaxityModel(knee=knee, protocol=_protocol())
    effects = [effect_named(knee, x) for x in ("bundles", "meniscus")]
    return model.with_effects([*effects, *model.effects])


def _displaced(model: LaxityModel) -> Array:
    p = model.parameters
    drawn = np.random.default_rng(0).standard_normal(p.n) * ~p.is_of_interest
    theta = np.clip(p.start + 0.1 * p.prior_sd * drawn, p.lower, p.upper)
    if "bundles.MCL_strain_spread_pct" in p.names:
        theta[p.index("bundles.MCL_strain_spread_pct")] = 4.0
    return np.asarray(theta)


def _found(model: LaxityModel, theta: Array) -> StructureWrenches:
    return structure_wrenches(model, model.predict(theta), *ROWS)


@pytest.mark.parametrize("make", some_slow([_grouped, _with_structures], [_with_structures]))
def test_slopes_are_those_of_differences(make: Callable[[], LaxityModel]) -> None:
    model = make()
    theta = _displaced(model)
    jacobian = _found(model, theta).jacobian
    p = model.parameters
    largest = np.abs(jacobian * p.prior_sd_in_own_units).max(axis=(0, 2))
    for i in few_places(p.names):
        move = np.zeros(p.n)
        move[i] = STEP * p.prior_sd_in_own_units[i]
        ends = [_found(model, theta + s * move).values for s in (-1.0, 1.0)]
        slope = (ends[1] - ends[0]) / (2.0 * STEP)
        made = jacobian[:, :, i] * p.prior_sd_in_own_units[i]
        np.testing.assert_allclose(made / largest, slope / largest, atol=SHARE)


def test_a_group_is_the_sum_of_its_bundles_and_pulls_as_its_lines_do() -> None:
    model = _grouped()
    theta = _displaced(model)
    prediction = model.predict(theta)
    whole = structure_wrenches(model, prediction, [1], ["MCL"])
    bundles = structure_wrenches(model, prediction, [1, 1], ["MCLa", "MCLp"])
    np.testing.assert_allclose(whole.values[0], bundles.values.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(whole.jacobian[0], bundles.jacobian.sum(axis=0), atol=1e-9)
    pulled = structure_wrenches(model, prediction, [0], ["ACL"]).values[0]
    tension, _ = structure_values(model, prediction, "ACL")
    assert tension[0] > 1.0
    np.testing.assert_allclose(np.linalg.norm(pulled[:3]), tension[0], rtol=1e-12)


def test_what_is_cut_by_half_pulls_half_as_hard_in_one_pose() -> None:
    model = _grouped()
    theta = np.array(model.parameters.start)
    k = model.parameters.index("LCL_50%/cut.fraction")
    part = model.parts[1]
    found = []
    for fraction in (0.25, 0.5):
        theta[k] = fraction
        prediction = model.predict(theta)
        # The same pose under both, which the model would leave.
        poses = np.array(model.predict(model.parameters.start).poses)
        held = part.prediction(replace(prediction, poses=poses))
        found.append(structure_wrenches(part.model, held, [0], ["LCL"]).values[0])
    np.testing.assert_allclose(found[0] / 0.75, found[1] / 0.5, rtol=1e-9, atol=1e-12)
