import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from identknee.runs.declare import Array
from identknee.subject.knee import Frame, angle_between, frames_from_landmarks

CLOSED_FORM = 1e-12  # a few roundings
PLACE = 1e-10  # mm; roundings of coordinates of several hundred mm


def landmarks() -> dict[str, Array]:
    """A right leg whose hip is medial of the knee and whose epicondyles are not level."""
    return {
        "hip_centre": np.array([5.0, 400.0, -30.0]),
        "medial_epicondyle": np.array([-2.0, 1.0, -40.0]),
        "lateral_epicondyle": np.array([2.0, -1.0, 40.0]),
        "medial_malleolus": np.array([3.0, -400.0, -35.0]),
        "lateral_malleolus": np.array([-3.0, -404.0, 25.0]),
    }


def test_there_and_back() -> None:
    frame = Frame(
        origin=np.array([1.0, 2.0, 3.0]), axes=Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix()
    )
    points = np.random.default_rng(0).normal(size=(7, 3))
    np.testing.assert_allclose(frame.to_common(frame.to_local(points)), points, atol=CLOSED_FORM)
    np.testing.assert_allclose(frame.to_local(frame.origin), 0.0)
    np.testing.assert_allclose(frame.to_local(frame.origin + frame.axes[0]), [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        (np.diag([1.0, 1.0, -1.0]), "right-handed"),
        (np.diag([1.0, 1.0, 2.0]), "unit vectors"),
        ([[1, 0, 0], [0.1, 1, 0], [0, 0, 1]], "right angles"),
        (np.full((3, 3), np.nan), "finite"),
        (np.eye(2), "shape 3 x 3"),
    ],
)
def test_refuses(axes: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Frame(origin=np.zeros(3), axes=np.array(axes, float))


def test_rounded_axes_are_squared_up() -> None:
    exact = Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix()
    axes = Frame(origin=np.zeros(3), axes=np.round(exact, 3)).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=CLOSED_FORM)
    np.testing.assert_allclose(axes, exact, atol=1e-3)


def test_exact_axes_are_kept() -> None:
    axes = Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix()
    np.testing.assert_array_equal(Frame(origin=np.zeros(3), axes=axes).axes, axes)


def test_mirrored_twice_is_the_same() -> None:
    frame = Frame(
        origin=np.array([1.0, 2.0, 3.0]), axes=Rotation.random(random_state=1).as_matrix()
    )
    mirrored = frame.mirrored()
    assert np.linalg.det(mirrored.axes) > 0.0
    np.testing.assert_array_equal(mirrored.mirrored().axes, frame.axes)
    point, mirror = np.array([4.0, 5.0, 6.0]), np.array([1.0, 1.0, -1.0])
    np.testing.assert_allclose(
        mirrored.to_local(point * mirror), frame.to_local(point) * mirror, atol=CLOSED_FORM
    )


def test_frames_from_landmarks() -> None:
    places = landmarks()
    femur, tibia = frames_from_landmarks(places)
    for frame in (femur, tibia):
        np.testing.assert_allclose(frame.origin, 0.0)
    local = femur.to_local(places["hip_centre"])
    np.testing.assert_allclose(local[[0, 2]], 0.0, atol=PLACE)
    assert local[1] > 0.0
    # The epicondyles lie in the frontal plane, the lateral one at positive z.
    local = femur.to_local(places["lateral_epicondyle"])
    assert abs(local[0]) < PLACE
    assert local[2] > 0.0
    ankle = (places["medial_malleolus"] + places["lateral_malleolus"]) / 2.0
    np.testing.assert_allclose(tibia.to_local(ankle)[[0, 2]], 0.0, atol=PLACE)
    assert abs(tibia.to_local(places["lateral_epicondyle"])[0]) < PLACE


def test_ankle_centre_stands_before_the_malleoli() -> None:
    ankle = np.array([20.0, -390.0, 0.0])
    _, tibia = frames_from_landmarks({**landmarks(), "ankle_centre": ankle})
    np.testing.assert_allclose(tibia.to_local(ankle)[[0, 2]], 0.0, atol=PLACE)


def test_left_leg_has_the_mirrored_frames() -> None:
    mirror = np.array([1.0, 1.0, -1.0])
    left = frames_from_landmarks({k: v * mirror for k, v in landmarks().items()}, is_left=True)
    for found, right in zip(left, frames_from_landmarks(landmarks()), strict=True):
        np.testing.assert_allclose(found.mirrored().axes, right.axes, atol=CLOSED_FORM)


def test_frames_follow_the_leg() -> None:
    turn, shift = Rotation.random(random_state=2).as_matrix(), np.array([10.0, 20.0, 30.0])
    moved = frames_from_landmarks({k: turn @ v + shift for k, v in landmarks().items()})
    for found, still in zip(moved, frames_from_landmarks(landmarks()), strict=True):
        np.testing.assert_allclose(found.axes, still.axes @ turn.T, atol=CLOSED_FORM)
        np.testing.assert_allclose(found.origin, shift, atol=PLACE)


def test_missing_landmark() -> None:
    places = landmarks()
    del places["lateral_epicondyle"]
    with pytest.raises(ValueError, match="hip_centre"):
        frames_from_landmarks(places)


@pytest.mark.parametrize("lateral", [[-2.0, 1.0, -40.0], [3.0, 401.0, -70.0]])
def test_landmarks_that_define_no_frame(lateral: list[float]) -> None:
    places = {**landmarks(), "lateral_epicondyle": np.array(lateral)}
    if lateral[1] > 1.0:
        places["hip_centre"] = np.array([8.0, 801.0, -100.0])
    with pytest.raises(ValueError, match="no frame"):
        frames_from_landmarks(places)


def test_angle_of_nearly_parallel_vectors() -> None:
    small = 1e-9
    found = angle_between(np.array([1.0, 0.0, 0.0]), np.array([1.0, small, 0.0]))
    np.testing.assert_allclose(found, np.degrees(small), rtol=CLOSED_FORM)
