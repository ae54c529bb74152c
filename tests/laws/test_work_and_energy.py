"""Forces are slopes of the energy, and what the tibia is given the femur bears."""

import numpy as np
import pytest
from energy_evaluation import (
    SCALE,
    Evaluator,
    depths,
    femoral_places,
    field_values,
    ligaments_of,
    random_parameters,
)
from hypothesis import given
from hypothesis import strategies as st

from identknee.laxity.protocol import Protocol
from identknee.mechanics.distance_field import PRESSURE_MODULUS
from identknee.mechanics.pose import rotation_matrix
from identknee.model.laxity_model import ContactGeometry, LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction
from identknee.model.quantities import quantity_named
from identknee.runs.declare import Array, IntArray

# Simpson's rule over forces whose slope jumps where a point begins to touch: the worst of 1,500
# paths errs by 3e-6 of the largest force.
QUADRATURE = 1e-5
# Contact forces from differences of the spline with a step of 1e-5 mm, summed up to 2,000 N.
BALANCE_N = 1e-4

seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds, trial=st.integers(0, 62), size=st.floats(0.05, 2.0))
def test_work_along_a_path_is_the_energy_stored(
    reference_model: LaxityModel,
    reference_prediction: Prediction,
    seed: int,
    trial: int,
    size: float,
) -> None:
    """Along a bent way between two poses near an equilibrium."""
    rng = np.random.default_rng(seed)
    flexion = float(np.radians(reference_model.protocol.flexion_deg[trial]))
    load = rng.normal(0.0, 50.0, 5) * SCALE
    ligaments = ligaments_of(reference_model, random_parameters(reference_model, rng))
    there, back, bend = reference_prediction.poses[trial] + rng.normal(0.0, size, (3, 5)) / SCALE
    evaluate, n = Evaluator(reference_model.joint), 400
    values, power = [], []
    for s in np.linspace(0.0, 1.0, n + 1):
        pose = (1 - s) ** 2 * there + 2 * s * (1 - s) * bend + s**2 * back
        velocity = 2 * (1 - s) * (bend - there) + 2 * s * (back - bend)
        evaluation = evaluate(flexion, pose, ligaments, load)
        values.append(evaluation.energy)
        power.append(evaluation.gradient @ velocity)
    weights = np.r_[1, np.tile([4, 2], n // 2)[:-1], 1] / (3 * n)
    assert weights @ power == pytest.approx(
        values[-1] - values[0], abs=QUADRATURE * max(np.ptp(values), np.abs(power).max())
    )


def _contact_forces(
    joint: ContactGeometry, flexion: float, pose: Array
) -> tuple[Array, Array, IntArray]:
    """Force of the femur on tibial points [N], where it acts and which they are, by brute force."""
    places = femoral_places(flexion, pose, joint.contact.points)
    depth = depths(joint, flexion, pose)
    inside = depth < 0.0
    places, step = places[inside], 1e-5
    slopes = [
        (field_values(joint.field, places + x) - field_values(joint.field, places - x)) / (2 * step)
        for x in step * np.eye(3)
    ]
    size = PRESSURE_MODULUS * joint.contact.areas[inside] * depth[inside]
    return -size[:, None] * np.transpose(slopes), places, np.flatnonzero(inside)


@given(trial=st.integers(0, 62), seed=seeds)
def test_forces_on_the_tibia_balance(reference_model: LaxityModel, trial: int, seed: int) -> None:
    """Contact and tensions add up in space to the opposite of the load, in force and in moment.

    The femur bears the opposite of each at the same place: what it bears is the load itself.
    """
    rng = np.random.default_rng(seed)
    theta = random_parameters(reference_model, rng, share=0.1, pct=0.5)
    single = reference_model.with_protocol(reference_model.protocol.select([trial]))
    found = single.predict(theta)
    if not found.all_converged:
        return
    flexion, pose = float(np.radians(single.protocol.flexion_deg[0])), found.poses[0]
    forces, places, _ = _contact_forces(single.joint, flexion, pose)
    rotation = rotation_matrix(flexion, pose[0], pose[1])
    origin = rotation_matrix(flexion, 0.0, 0.0) @ pose[2:]
    tibial = single.joint.lines.tibial @ rotation.T + origin
    along = single.joint.lines.femoral - tibial
    pulls = tensions_of(single, found)[0][:, None] * along / np.linalg.norm(along, axis=1)[:, None]
    force = forces.sum(axis=0) + pulls.sum(axis=0)
    moment = np.cross(places - origin, forces).sum(axis=0)
    moment += np.cross(tibial - origin, pulls).sum(axis=0)
    # These trials have no applied force. Moments act about the axes that their angles turn about.
    assert np.abs(force).max() <= BALANCE_N
    internal, varus = single.protocol.loads[0, :2] * 1000.0
    superior, floating = rotation[:, 1], rotation_matrix(flexion, 0.0, 0.0)[:, 0]
    assert moment @ superior == pytest.approx(-internal, abs=40.0 * BALANCE_N)
    assert moment @ floating == pytest.approx(-varus, abs=40.0 * BALANCE_N)


@given(
    seed=seeds,
    flexion_deg=st.sampled_from([0.0, 30.0, 60.0]),
    load=st.tuples(st.floats(-40, 40), st.floats(-400, -50), st.floats(-20, 20)),
)
def test_named_contact_and_tensions_are_what_balances_an_applied_force(
    reference_model: LaxityModel, seed: int, flexion_deg: float, load: tuple[float, float, float]
) -> None:
    """Along all three axes, none of which the rig holds.

    The forces of a compartment's elements, of which the quantity is the sum of sizes and the place
    the mean, add up in space with the tensions to the opposite of the load.
    """
    anterior, distraction, lateral = load
    protocol = Protocol(
        name="one",
        trials=("pushed",),
        flexion_deg=np.array([flexion_deg]),
        loads=np.array([[0.0, 0.0, anterior, distraction, lateral]]),
    )
    model = reference_model.with_protocol(protocol)
    theta = random_parameters(reference_model, np.random.default_rng(seed), share=0.1, pct=0.5)
    found = model.predict(theta)
    if not found.all_converged:
        return
    flexion, pose = float(np.radians(flexion_deg)), found.poses[0]
    forces, _, which = _contact_forces(model.joint, flexion, pose)
    points, compartment = model.joint.contact.points[which], model.joint.contact.compartment[which]
    for c, side in enumerate(("medial", "lateral")):
        size = np.linalg.norm(forces[compartment == c], axis=1)
        values = [
            quantity_named(model, f"contact.{side}_{x}@pushed").value(found)
            for x in ("N", "x_mm", "y_mm", "z_mm")
        ]
        assert values[0] == pytest.approx(size.sum(), abs=BALANCE_N)
        if values[0] > 1.0:
            centre = size @ points[compartment == c] / size.sum()
            assert values[1:] == pytest.approx(centre.tolist(), abs=BALANCE_N)
    tensions = [
        quantity_named(model, f"{x.name}.tension_N@pushed").value(found)
        for x in model.knee.ligaments
    ]
    flexed = rotation_matrix(flexion, 0.0, 0.0)
    tibial = femoral_places(flexion, pose, model.joint.lines.tibial)
    along = model.joint.lines.femoral - tibial
    pulls = np.array(tensions)[:, None] * along / np.linalg.norm(along, axis=1)[:, None]
    applied = flexed @ [anterior, -distraction, lateral]
    assert np.abs(forces.sum(axis=0) + pulls.sum(axis=0) + applied).max() <= BALANCE_N
