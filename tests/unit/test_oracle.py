"""The oracle itself, against closed forms: one line, one point on fields that splines reproduce."""

import math

import numpy as np
import oracle
import pytest
from oracle import OracleKnee, State

# Closed forms: a few dozen roundings of numbers of their own size.
CLOSED_FORM = 1e-12
SPACING = 0.75
ORIGIN = [-6.0, -5.0, -4.0]
NODES = 17
NO_LOAD = [0.0] * 5


def _field(of_node: np.ndarray) -> list[list[list[float]]]:
    return of_node.tolist()  # type: ignore[no-any-return]


def _nodes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    ticks = SPACING * np.arange(NODES)
    x, y, z = np.meshgrid(*(start + ticks for start in ORIGIN), indexing="ij")
    return x, y, z


def _knee(coefficients: np.ndarray, points: list[list[float]], areas: list[float]) -> OracleKnee:
    return OracleKnee(
        coefficients=_field(coefficients),
        origin=ORIGIN,
        spacing=SPACING,
        points=points,
        areas=areas,
        femoral=[],
        tibial=[],
        reference_length=[],
    )


def _plane() -> OracleKnee:
    """The femur is the half space above the plane 0.6 y + 0.8 z = 0.5; two points, one in touch."""
    _, y, z = _nodes()
    # A cubic spline whose coefficients are a linear function's values is that function.
    return _knee(0.5 - 0.6 * y - 0.8 * z, [[0.3, 1.2, 0.4], [0.0, -2.0, 0.0]], [1.7, 5.0])


def _lines() -> OracleKnee:
    femoral = [[0.0, 5.0, -10.0], [3.0, -4.0, 12.0], [1.0, 8.0, 40.0], [1.0, 3.0, 2.0]]
    tibial = [[10.0, -20.0, 2.0], [-15.0, -25.0, 0.0], [-9.0, -45.0, 44.0], [0.0, -30.0, 2.0]]
    lengths = [math.dist(f, t) for f, t in zip(femoral, tibial, strict=True)]
    x, _, _ = _nodes()
    return OracleKnee(
        coefficients=_field(np.ones_like(x)),
        origin=ORIGIN,
        spacing=SPACING,
        points=[],
        areas=[],
        femoral=femoral,
        tibial=tibial,
        reference_length=lengths,
    )


UNLOADED = State(flexion=0.0, load=NO_LOAD, stiffness=[], strain=[])
PULLED = State(
    flexion=0.0,
    load=NO_LOAD,
    stiffness=[10000.0, 18000.0, 6000.0, 8000.0],
    strain=[0.08, 0.02, -0.1, 0.05],
)


def test_one_point_behind_a_plane_stores_half_p_a_d_squared() -> None:
    depth = 0.6 * 1.2 + 0.8 * 0.4 - 0.5
    found = oracle.energy(_plane(), UNLOADED, NO_LOAD)
    assert found == pytest.approx(0.5 * 10.0 * 1.7 * depth**2, rel=CLOSED_FORM)


def test_one_point_behind_a_plane_is_pushed_along_its_normal() -> None:
    size = 10.0 * 1.7 * (0.6 * 1.2 + 0.8 * 0.4 - 0.5)
    # Varus moves the point by (0, -0.4, 1.2) mm a radian, internal rotation by (0.4, 0, -0.3).
    expected = [size * (-0.6 * 0.4 + 0.8 * 1.2), -size * 0.8 * 0.3, 0.0, 0.6 * size, 0.8 * size]
    found = oracle.gradient(_plane(), UNLOADED, NO_LOAD)
    assert found == pytest.approx(expected, rel=CLOSED_FORM)
    curvature = np.array(oracle.hessian(_plane(), UNLOADED, NO_LOAD))[2:, 2:]
    normal = np.array([0.0, 0.6, 0.8])
    assert curvature == pytest.approx(17.0 * np.outer(normal, normal), rel=CLOSED_FORM, abs=1e-12)


def test_a_flexed_knee_moves_along_flexed_axes() -> None:
    """At 90 deg the tibia's y points backward: (x, y) of the pose become (y, -x) of the femur."""
    flexed = State(flexion=math.pi / 2, load=NO_LOAD, stiffness=[], strain=[])
    _, y, _ = _nodes()
    knee = _knee(1.0 - y, [[0.0, 0.0, 0.0]], [1.0])
    found = oracle.energy(knee, flexed, [0.0, 0.0, -2.0, 0.7, 0.3])
    assert found == pytest.approx(0.5 * 10.0 * 1.0, rel=CLOSED_FORM)


def test_the_field_reproduces_a_quadratic() -> None:
    x, y, z = _nodes()
    # The coefficients of u**2 are its values at the nodes less a third of a spacing squared.
    coefficients = 0.3 * (x**2 - SPACING**2 / 3.0) + 0.2 * x * y - 0.7 * z
    knee = _knee(coefficients, [], [])
    place = [0.31, -1.27, 2.2]
    value = 0.3 * place[0] ** 2 + 0.2 * place[0] * place[1] - 0.7 * place[2]
    slope = [0.6 * place[0] + 0.2 * place[1], 0.2 * place[0], -0.7]
    assert oracle.distance(knee, place) == pytest.approx(value, rel=CLOSED_FORM)
    assert oracle.distance_gradient(knee, place) == pytest.approx(slope, rel=CLOSED_FORM)


def test_outside_the_grid_nothing_touches() -> None:
    for place in ([-5.9, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 7.9]):
        assert oracle.distance(_plane(), place) == 1.0


@pytest.mark.parametrize("strain", [-0.2, 0.0, 0.02, 0.0599, 0.0601, 0.13])
def test_stored_energy_is_the_integral_of_the_tension(strain: float) -> None:
    steps = np.linspace(0.0, strain, 2001)
    values = [oracle.tension(e, 1000.0, 0.03) for e in steps]
    integral = np.trapezoid(values, steps)
    # The trapezoidal rule with 2,000 steps errs by a millionth.
    assert oracle.stored_energy(strain, 1000.0, 0.03) == pytest.approx(integral, rel=1e-5)


def test_one_line_stretched_along_itself() -> None:
    knee = OracleKnee(
        coefficients=_plane().coefficients,
        origin=ORIGIN,
        spacing=SPACING,
        points=[],
        areas=[],
        femoral=[[0.0, 10.0, 0.0]],
        tibial=[[0.0, -10.0, 0.0]],
        reference_length=[20.0],
    )
    state = State(flexion=0.0, load=NO_LOAD, stiffness=[1000.0], strain=[0.1])
    slack = 20.0 / 1.1
    strain = 22.0 / slack - 1.0
    pose = [0.0, 0.0, 0.0, -2.0, 0.0]
    stored = slack * 1000.0 * ((strain - 0.03) ** 2 / 2.0 + 0.03**2 / 6.0)
    assert oracle.energy(knee, state, pose) == pytest.approx(stored, rel=CLOSED_FORM)
    pull = 1000.0 * (strain - 0.03)
    assert oracle.gradient(knee, state, pose) == pytest.approx([0, 0, 0, -pull, 0], rel=CLOSED_FORM)
    curvature = oracle.hessian(knee, state, pose)
    assert curvature[3][3] == pytest.approx(1000.0 / slack, rel=CLOSED_FORM)
    assert curvature[2][2] == pytest.approx(pull / 22.0, rel=CLOSED_FORM)
    slopes = np.array(oracle.parameter_slopes(knee, state, pose))
    # d strain / d reference strain = length / reference length
    expected = [-(strain - 0.03), -1000.0 * 22.0 / 20.0]
    assert slopes[3] == pytest.approx(expected, rel=CLOSED_FORM)


def test_loads_are_potentials() -> None:
    pose = [0.1, -0.2, 0.3, -0.4, 0.5]
    load = [1000.0, -2000.0, 30.0, 40.0, -50.0]
    loaded = State(flexion=0.3, load=load, stiffness=PULLED.stiffness, strain=PULLED.strain)
    free = State(flexion=0.3, load=NO_LOAD, stiffness=PULLED.stiffness, strain=PULLED.strain)
    work = sum(f * q for f, q in zip(load, pose, strict=True))
    gained = oracle.energy(_lines(), free, pose) - oracle.energy(_lines(), loaded, pose)
    assert gained == pytest.approx(work, rel=1e-9)
    difference = np.array(oracle.gradient(_lines(), free, pose)) - np.array(
        oracle.gradient(_lines(), loaded, pose)
    )
    assert difference == pytest.approx(load, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_both_gradients_agree_and_the_hessian_is_symmetric(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines, x = _lines(), _nodes()
    bumpy = 1.0 - 0.5 * x[1] + 0.1 * rng.standard_normal(x[0].shape)
    knee = OracleKnee(
        coefficients=_field(bumpy),
        origin=ORIGIN,
        spacing=SPACING,
        points=rng.uniform(-3.0, 3.0, (40, 3)).tolist(),
        areas=rng.uniform(0.5, 2.0, 40).tolist(),
        femoral=lines.femoral,
        tibial=lines.tibial,
        reference_length=lines.reference_length,
    )
    state = State(flexion=0.2, load=[500.0, -300.0, 1.0, 2.0, 3.0], **_parameters())
    pose = [*rng.normal(0.0, 0.05, 2), *rng.normal(0.0, 0.3, 3)]
    coded = oracle.gradient(knee, state, pose)
    assert coded == pytest.approx(oracle.gradient_by_complex_step(knee, state, pose), rel=1e-11)
    curvature = np.array(oracle.hessian(knee, state, pose))
    assert curvature == pytest.approx(curvature.T, rel=1e-10, abs=1e-8)


def _parameters() -> dict[str, oracle.Vector]:
    return {"stiffness": PULLED.stiffness, "strain": PULLED.strain}


def test_independent_minimum_of_a_quadratic() -> None:
    """A plate of nine points, held in its plane by long lines, sinks in as a spring would."""
    _, y, _ = _nodes()
    points = [[float(i), 0.0, float(k)] for i in (-2, 0, 2) for k in (-2, 0, 2)]
    knee = OracleKnee(
        coefficients=_field(-y),
        origin=ORIGIN,
        spacing=SPACING,
        points=points,
        areas=[1.0] * 9,
        # A long line along x, one along z and one at the end of a lever hold what the plane leaves.
        femoral=[[-1000.0, 0.0, 0.0], [0.0, 0.0, -1000.0], [-1000.0, 0.0, 2.0]],
        tibial=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0]],
        reference_length=[1000.0, 1000.0, 1000.0],
    )
    state = State(
        flexion=0.0,
        load=[0.0, 140.0, 140.0, 45.0, 70.0],
        stiffness=[1000.0, 1000.0, 1000.0],
        strain=[0.1, 0.1, 0.1],
    )
    pose, residual = oracle.independent_minimum(knee, state, [0.0, 0.0, 0.2, 0.2, 0.2])
    assert residual < 1e-6
    # 45 N on nine points of 10 N/mm; across them a line of 70 N and 1000 mm adds 0.07 N/mm.
    assert pose[3] == pytest.approx(45.0 / (90.0 + 3 * 0.07), rel=1e-6)
    assert pose[[0, 1, 2, 4]] == pytest.approx(np.zeros(4), abs=2e-3)


def test_sensitivities_are_slopes_of_the_minimum() -> None:
    """Four taut lines press four points into a bowl; the minimum is found again nearby."""
    x, y, z = _nodes()
    third = SPACING**2 / 3.0
    knee = OracleKnee(
        coefficients=_field(-4.0 - y - 0.05 * ((x**2 - third) + (z**2 - third))),
        origin=ORIGIN,
        spacing=SPACING,
        points=[[2.0, -3.0, 0.0], [-2.0, -3.0, 0.0], [0.0, -3.0, 2.0], [0.0, -3.0, -2.0]],
        areas=[20.0] * 4,
        femoral=[[10.0, 10.0, 3.0], [-10.0, 10.0, 3.0], [-2.0, 10.0, 30.0], [2.0, 10.0, -30.0]],
        tibial=[[8.0, -20.0, 0.0], [-8.0, -20.0, 0.0], [0.0, -30.0, 25.0], [0.0, -30.0, -25.0]],
        reference_length=[30.0, 30.0, 40.0, 40.0],
    )
    state = State(flexion=0.0, load=NO_LOAD, **_parameters())
    pose, residual = oracle.independent_minimum(knee, state, NO_LOAD, tolerance=1e-9)
    assert residual < 1e-6
    found = oracle.sensitivities(knee, state, pose.tolist())
    step = 1e-4
    ends = []
    for sign in (1.0, -1.0):
        strain = [PULLED.strain[0] + sign * step, *PULLED.strain[1:]]
        moved = State(flexion=0.0, load=NO_LOAD, stiffness=PULLED.stiffness, strain=strain)
        ends.append(oracle.independent_minimum(knee, moved, pose.tolist(), tolerance=1e-9)[0])
    assert found[:, 4] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4, abs=1e-5)
