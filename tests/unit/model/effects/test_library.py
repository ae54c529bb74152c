"""Every effect of the library: nothing at zero, exact slopes elsewhere, one answer for one knee."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_knee import small_knee, small_protocol
from tolerances import DIFFERENCE, SAME_POSE

from identknee.laxity.protocol import Protocol
from identknee.model import laxity_model as joint
from identknee.model.effects.facts import FACTS, NOT_OFFERED
from identknee.model.effects.library import effect_named, library
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.knee import Knee

HISTORY = {"hysteresis", "creep", "drift"}
NUMERICAL = ["contact_law"]
NAMES = [x for x in FACTS if x not in NOT_OFFERED]
# A difference of solved poses [mm, deg] over this share of an amplitude's range.
STEP = 1e-5
# The same field made between other roundings [mm, deg].
MOVED = 1e-8
# Forward and backward differences that differ by more have a kink between them: a point began to
# touch or a line to carry.
KINK = 1e-4
PROTOCOL = Protocol(
    name="few",
    trials=("rest", "internal", "external", "varus", "valgus", "bent", "drawer"),
    flexion_deg=np.array([30.0, 30.0, 60.0, 30.0, 0.0, 60.0, 30.0]),
    loads=np.array(
        [
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [6.0, 0.0, 0.0, 0.0, 0.0],
            [-4.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 8.0, 0.0, 0.0, 0.0],
            [0.0, -7.0, 0.0, 0.0, 0.0],
            [2.0, 2.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 40.0, 0.0, 0.0],
        ]
    ),
)


@pytest.fixture(scope="module")
def plain(reference: Knee) -> LaxityModel:
    """The reference knee in a few trials whose history is known."""
    return LaxityModel(
        knee=reference,
        protocol=PROTOCOL,
        order=np.array([4, 1, 7, 3, 2, 6, 5]),
        phase=("", "loading", "unloading", "loading", "unloading", "loading", "loading"),
    )


def extended(model: LaxityModel, name: str) -> LaxityModel:
    return model.with_effects([effect_named(model.knee, name)])


def drawn(model: LaxityModel, generator: np.random.Generator) -> Array:
    """Ligaments near the subject's, amplitudes within a prior standard deviation and the range."""
    parameters, n = model.parameters, model.n_ligament_parameters
    theta = np.array(parameters.center)
    theta[:n] += 0.02 * generator.uniform(-1.0, 1.0, n) * np.maximum(np.abs(theta[:n]), 1.0)
    moves = generator.uniform(0.3, 1.0, theta.size - n) * parameters.prior_sd[n:]
    moves *= generator.choice([-1.0, 1.0], moves.size)
    if parameters.names[n].startswith("muscle_tension"):
        # All muscles at once would throw the small knee out of its joint.
        moves *= 0.4
    moves = np.where(parameters.lower[n:] == 0.0, np.abs(moves), moves)
    theta[n:] = np.clip(theta[n:] + moves, parameters.lower[n:], parameters.upper[n:])
    return theta


def without(theta: Array, model: LaxityModel) -> Array:
    """The same theta with all amplitudes zero that make an effect one."""
    names = model.parameters.names[model.n_ligament_parameters :]
    is_structure = any(x.endswith("stiffness_kN") for x in names)
    kept = [is_structure and not x.endswith("stiffness_kN") for x in names]
    zero = np.array(theta)
    zero[model.n_ligament_parameters :][~np.array(kept)] = 0.0
    return zero


def test_the_library_holds_what_is_known_of_a_trial(reference: Knee) -> None:
    whole = [x.name for x in library(reference, has_order=True, has_phase=True)]
    causes = [x for x in NAMES if x not in NUMERICAL]
    assert whole == causes
    assert [x.name for x in library(reference)] == [x for x in causes if x not in HISTORY]
    assert [x.name for x in library(reference, has_order=True)][-2:] == ["creep", "drift"]


def test_facts_speak_of_each_effect() -> None:
    for name, facts in FACTS.items():
        assert facts.name == name
        assert facts.sentence.endswith(".")
        assert facts.source
        assert facts.relevant > 0.0
    assert [x for x in NAMES if FACTS[x].is_numerical] == NUMERICAL


@pytest.mark.parametrize("name", NAMES)
def test_amplitudes_worth_knowing_are_plausible(name: str, reference: Knee) -> None:
    parameters = effect_named(reference, name).parameters
    assert all(x.startswith(f"{name}.") for x in parameters.names)
    assert FACTS[name].relevant < parameters.upper[0]
    assert (parameters.lower <= parameters.center).all()
    assert (parameters.center < parameters.upper).all()


def test_a_structure_that_a_subject_has_is_not_missing(reference: Knee) -> None:
    first, *others = reference.ligaments
    knee = reference.with_ligaments([replace(first, name="anterolateral"), *others])
    assert [x.name for x in library(knee)] == [x.name for x in library(reference)][1:]


def test_wrapping_needs_a_ligament_that_wraps(reference: Knee) -> None:
    cruciates = reference.with_ligaments([x for x in reference.ligaments if abs(x.femur[2]) < 20.0])
    assert "mcl_wrapping" not in [x.name for x in library(cruciates)]
    with pytest.raises(ValueError, match="medial collateral"):
        effect_named(cruciates, "mcl_wrapping")


def test_an_unknown_name_is_refused(reference: Knee) -> None:
    with pytest.raises(ValueError, match=r"anterolatteral.*anterolateral"):
        effect_named(reference, "anterolatteral")


@given(name=st.sampled_from(NAMES), seed=st.integers(0, 2**32 - 1))
def test_zero_amplitudes_change_nothing(plain: LaxityModel, name: str, seed: int) -> None:
    model = extended(plain, name)
    theta = without(drawn(model, np.random.default_rng(seed)), model)
    found = model.predict(theta, derivatives=False)
    bare = plain.predict(theta[: model.n_ligament_parameters], derivatives=False)
    np.testing.assert_array_equal(found.codes, bare.codes)
    assert np.abs(found.coordinates - bare.coordinates)[bare.is_converged].max() <= SAME_POSE


@pytest.mark.parametrize("name", NAMES)
def test_the_jacobian_by_amplitudes_is_the_slope_of_what_is_solved(
    name: str, plain: LaxityModel
) -> None:
    model = extended(plain, name)
    theta = drawn(model, np.random.default_rng(NAMES.index(name)))
    found = model.predict(theta)
    assert found.all_converged
    assert found.jacobian is not None
    parameters, kinks = model.parameters, 0
    for k in range(model.n_ligament_parameters, parameters.n):
        move = np.zeros(parameters.n)
        move[k] = STEP * (parameters.upper[k] - parameters.lower[k])
        high, low = (
            model.predict(theta + s * move, derivatives=False).coordinates for s in (1.0, -1.0)
        )
        slopes = (high - low) / (2.0 * move[k])
        bend = np.abs(high - 2.0 * found.coordinates + low) / move[k]
        size = max(np.abs(found.jacobian[:, :, k]).max(), 1e-9)
        smooth = bend.max(axis=1) <= KINK * size
        kinks += int((~smooth).sum())
        error = np.abs(slopes - found.jacobian[:, :, k])[smooth]
        assert error.max() <= DIFFERENCE * size
    assert kinks <= 0.05 * PROTOCOL.n * parameters.n


def test_all_effects_act_together(plain: LaxityModel, reference: Knee) -> None:
    """Lines that share a ligament, are shifted, lifted and toed in one setting."""
    model = plain.with_effects(library(reference, has_order=True, has_phase=True))
    theta = np.array(model.parameters.center)
    n = model.n_ligament_parameters
    rng = np.random.default_rng(3)
    theta[n:] = np.clip(
        theta[n:] + 0.1 * model.parameters.prior_sd[n:] * rng.uniform(0.5, 1.0, theta.size - n),
        model.parameters.lower[n:],
        model.parameters.upper[n:],
    )
    found = model.predict(theta)
    assert found.all_converged
    assert found.jacobian is not None
    way = 1e-4 * model.parameters.prior_sd * rng.uniform(-1.0, 1.0, theta.size)
    high, low = (model.predict(theta + s * way, derivatives=False).coordinates for s in (1.0, -1.0))
    wanted = found.jacobian @ way
    assert np.abs(0.5 * (high - low) - wanted).max() <= DIFFERENCE * np.abs(wanted).max()


@pytest.fixture
def small(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint, "cache_folder", lambda: tmp_path)


@pytest.mark.usefixtures("small")
def test_a_moved_and_renamed_knee_answers_alike() -> None:
    """All effects are placed by the knee's own anatomy, wherever it lies and whatever its names."""
    turn = Rotation.random(random_state=5).as_matrix()
    names = ("uno", "due", "tre", "quattro")
    moved = small_knee(rotation=turn, translation=np.array([120.0, -80.0, 300.0]), names=names)
    knees = [small_knee(), moved]
    protocol = small_protocol()
    rng = np.random.default_rng(8)
    for made in zip(*(library(x) for x in knees), strict=True):
        models = [
            LaxityModel(knee=knee, protocol=protocol, effects=[effect])  # type: ignore[arg-type]
            for knee, effect in zip(knees, made, strict=True)
        ]
        theta = drawn(models[0], rng)
        one, other = (x.predict(theta, derivatives=False) for x in models)
        np.testing.assert_array_equal(one.codes, other.codes)
        same = np.abs(one.coordinates - other.coordinates)[one.is_converged]
        assert same.size == 0 or same.max() <= MOVED, made[0].name
