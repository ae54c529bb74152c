"""Poses depend on ratios of forces, and angles on ratios of lengths."""

from dataclasses import replace

import numpy as np
from energy_evaluation import SCALE, ligaments_of
from hypothesis import given
from hypothesis import strategies as st

from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import ContactPoints, LineLigaments, load_paths, solve
from identknee.mechanics.memory import CONVERGED, Equilibria
from identknee.model.laxity_model import ContactGeometry, LaxityModel
from identknee.runs.declare import Array

# Stiffer or larger, the same residual leaves the pose elsewhere by as much less or more; paths of
# other steps end on the same branch to 1e-9, here times the largest factor.
SAME_MM = 1e-8

trials = st.lists(st.integers(0, 62), min_size=1, max_size=3, unique=True)


def _solved(
    model: LaxityModel, joint: ContactGeometry, trials: list[int], force: float, length: float
) -> Equilibria:
    """Equilibria with loads, stiffnesses and contact `force` times as large, lengths `length`."""
    nodes = model.paths.trial_node[trials]
    moment = np.r_[force * length, force * length, force, force, force]
    paths = load_paths(
        model.paths.flexion[nodes], model.paths.loads[nodes] * moment, joint.start_flexion
    )
    lines = ligaments_of(model, model.parameters.center)
    lines.femoral, lines.tibial = joint.lines.femoral, joint.lines.tibial
    lines.stiffness *= force
    lines.reference_length *= length
    lines.wrap_offset *= length
    found = solve(paths, joint.start, joint.contact, joint.field, lines, derivatives=False)
    assert (found.codes[paths.trial_node] == CONVERGED).all()
    return found._replace(poses=found.poses[paths.trial_node])


def _reference(model: LaxityModel, trials: list[int]) -> Array:
    return _solved(model, model.joint, trials, 1.0, 1.0).poses


@given(factor=st.floats(0.2, 5.0), trials=trials)
def test_all_stiffnesses_and_loads_together_leave_the_pose_alike(
    reference_model: LaxityModel, factor: float, trials: list[int]
) -> None:
    here = reference_model.joint
    # The pressure modulus enters beside the areas only.
    contact = ContactPoints(
        points=here.contact.points,
        areas=factor * here.contact.areas,
        compartment=here.contact.compartment,
    )
    found = _solved(reference_model, replace(here, contact=contact), trials, factor, 1.0).poses
    difference = (found - _reference(reference_model, trials)) * SCALE
    assert np.abs(difference).max() <= SAME_MM


@given(factor=st.floats(0.5, 2.0), trials=trials)
def test_a_larger_knee_under_larger_loads_turns_by_the_same_angles(
    reference_model: LaxityModel, factor: float, trials: list[int]
) -> None:
    """Lengths times c and forces times c cubed, as area times depth gives."""
    here = reference_model.joint
    large = replace(
        here,
        field=DistanceField(
            coefficients=factor * here.field.coefficients,
            reach=here.field.reach,
            near=here.field.near,
            origin=factor * here.field.origin,
            spacing=factor * here.field.spacing,
        ),
        contact=ContactPoints(
            points=factor * here.contact.points,
            areas=factor**2 * here.contact.areas,
            compartment=here.contact.compartment,
        ),
        lines=LineLigaments(
            femoral=factor * here.lines.femoral,
            tibial=factor * here.lines.tibial,
            reference_length=factor * here.lines.reference_length,
        ),
        start=here.start * [1.0, 1.0, factor, factor, factor],
    )
    found = _solved(reference_model, large, trials, factor**3, factor).poses
    expected = _reference(reference_model, trials) * [1.0, 1.0, factor, factor, factor]
    assert np.abs((found - expected) * SCALE).max() <= SAME_MM


def test_but_contact_alone_twice_as_stiff_does_not(reference_model: LaxityModel) -> None:
    """The law above says something: half of the factors do change the pose."""
    here = reference_model.joint
    contact = ContactPoints(
        points=here.contact.points,
        areas=2.0 * here.contact.areas,
        compartment=here.contact.compartment,
    )
    found = _solved(reference_model, replace(here, contact=contact), [40], 1.0, 1.0).poses
    difference = (found - _reference(reference_model, [40])) * SCALE
    assert np.abs(difference).max() > 1e4 * SAME_MM
