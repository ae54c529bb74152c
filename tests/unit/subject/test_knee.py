import pickle
from dataclasses import replace

import numpy as np
import pytest
from posed_knees import posed_reference

from identknee.mechanics.distance_field import MOST_ROUNDING
from identknee.subject.knee import MOST_CONTACT_ROUNDING, Knee, Landmark
from identknee.subject.reference import reference_knee

CLOSED_FORM = 1e-12  # a few roundings


@pytest.fixture(scope="module")
def knee() -> Knee:
    return reference_knee(3.0, femur_edge_mm=3.0)


def test_lengths_and_names(knee: Knee) -> None:
    assert knee.reference_lengths.tolist() == [x.length for x in knee.ligaments]
    assert knee.ligament("PCL") is knee.ligaments[1]
    with pytest.raises(ValueError, match="the ligaments are ACL, PCL, LCL, MCL"):
        knee.ligament("PLC")


def test_refuses(knee: Knee) -> None:
    with pytest.raises(ValueError, match="two ligaments are called ACL"):
        knee.with_ligaments([*knee.ligaments, knee.ligaments[0]])
    with pytest.raises(ValueError, match="right"):
        replace(knee, side="both")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="medial and a lateral"):
        replace(knee, tibia=knee.tibia[:1])
    with pytest.raises(ValueError, match="hip_centre must be finite"):
        Landmark(name="hip_centre", position=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"contact_rounding_mm must be 0 to 0.15 mm, got 0.2"):
        replace(knee, contact_rounding_mm=0.2)
    assert MOST_CONTACT_ROUNDING == MOST_ROUNDING


def test_the_mirror_shows_the_same_knee() -> None:
    knee = replace(
        posed_reference(4), landmarks=(Landmark(name="hip_centre", position=np.ones(3)),)
    )
    mirrored = knee.mirrored()
    mirror = np.array([1.0, 1.0, -1.0])
    np.testing.assert_allclose(mirrored.reference_lengths, knee.reference_lengths, rtol=CLOSED_FORM)
    assert mirrored.landmarks[0].position.tolist() == [1.0, 1.0, -1.0]
    for one, other in ((knee, mirrored), (mirrored.mirrored(), mirrored)):
        np.testing.assert_allclose(
            one.femur_frame.to_local(one.femur.vertices),
            other.femur_frame.to_local(other.femur.vertices) * mirror,
            atol=1e-9,  # coordinates of several hundred mm
        )


def test_the_mirrored_distance_is_that_of_the_mirrored_surface(knee: Knee) -> None:
    mirrored = knee.mirrored()
    assert mirrored.femur_distance is not None
    np.testing.assert_allclose(mirrored.femur_distance(mirrored.femur.vertices), 0.0, atol=1e-9)


def test_a_knee_goes_to_another_process(knee: Knee) -> None:
    back = pickle.loads(pickle.dumps(knee))
    np.testing.assert_array_equal(back.femur.vertices, knee.femur.vertices)
    assert back.femur_distance is not None
