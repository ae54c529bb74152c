"""Muscle tension: the same as the forces and moments of its lines, and what it does to a knee."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.protocol import load_protocol
from identknee.model.effects.library import effect_named
from identknee.model.effects.loads import LATERAL, MUSCLES
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.anatomy import anatomy
from identknee.subject.knee import Knee

VARUS, INTERNAL, X, Y, Z = range(5)
FORCE_N = 50.0


def model_at(knee: Knee, *angles_deg: float) -> LaxityModel:
    """Unloaded trials at some angles, with muscle tension."""
    n = len(angles_deg)
    protocol = replace(
        load_protocol("seed63").select(np.arange(n)),
        flexion_deg=np.array(angles_deg),
        loads=np.zeros((n, 5)),
    )
    return LaxityModel(
        knee=knee, protocol=protocol, effects=(effect_named(knee, "muscle_tension"),)
    )


def loads(knee: Knee, muscle: str, *angles_deg: float) -> Array:
    """What a pull of one muscle adds to the loads, shape ``(n, 5)``."""
    model = model_at(knee, *angles_deg)
    theta = model.parameters.vector({f"muscle_tension.{muscle}_N": FORCE_N})
    return model.setting(theta).loads[model.paths.trial_node]


def test_hamstrings_compress_a_straight_knee_and_draw_a_bent_one_back(reference: Knee) -> None:
    straight, bent = loads(reference, "hamstrings", 0.0, 90.0)
    np.testing.assert_allclose(straight[[X, Y, Z]], [0.0, FORCE_N, 0.0], atol=1e-9)
    np.testing.assert_allclose(bent[[X, Y, Z]], [-FORCE_N, 0.0, 0.0], atol=1e-9)


def test_the_quadriceps_draws_a_straight_knee_forward_and_a_bent_one_back(reference: Knee) -> None:
    straight, bent = loads(reference, "quadriceps", 0.0, 90.0)
    assert straight[X] == pytest.approx(FORCE_N * np.sin(np.radians(20.0)))
    assert bent[X] == pytest.approx(-FORCE_N * np.sin(np.radians(7.0)))


@pytest.mark.parametrize("muscle", MUSCLES)
def test_moments_are_those_of_the_force_where_it_crosses_the_joint(
    muscle: str, reference: Knee
) -> None:
    found = loads(reference, muscle, 0.0, 30.0, 60.0)
    places = anatomy(reference)
    lateral = places.size * LATERAL[MUSCLES.index(muscle)] + np.mean(
        [
            reference.tibia_frame.to_local(x.plateau_centre)[2]
            for x in (places.medial, places.lateral)
        ]
    )
    moments = np.cross([0.0, 0.0, lateral], found[:, [X, Y, Z]])
    np.testing.assert_allclose(found[:, [VARUS, INTERNAL]], moments[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found[:, [X, Y, Z]], axis=1), FORCE_N)


def test_a_line_may_lie_further_to_one_side_and_lean(reference: Knee) -> None:
    model = model_at(reference, 0.0)

    def found(**values: float) -> Array:
        theta = model.parameters.vector({f"muscle_tension.{x}": y for x, y in values.items()})
        return np.asarray(model.setting(theta).loads[model.paths.trial_node][0])

    plain = found(hamstrings_N=FORCE_N)
    aside = found(hamstrings_N=FORCE_N, hamstrings_lateral_mm=4.0)
    np.testing.assert_allclose(aside - plain, [-4.0 * FORCE_N, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    leaning = found(hamstrings_N=FORCE_N, hamstrings_forward_deg=5.0)
    assert leaning[X] == pytest.approx(FORCE_N * np.sin(np.radians(5.0)))
    # Without tension a line does nothing, wherever it lies.
    np.testing.assert_array_equal(found(hamstrings_lateral_mm=4.0), found())


def test_tense_hamstrings_hold_the_tibia_back(reference: Knee) -> None:
    model = model_at(reference, 30.0, 60.0)
    relaxed = model.predict(model.parameters.center, derivatives=False)
    tense = model.predict(
        model.parameters.vector({"muscle_tension.hamstrings_N": FORCE_N}), derivatives=False
    )
    assert (tense.coordinates[:, 1] < relaxed.coordinates[:, 1] - 0.3).all()
