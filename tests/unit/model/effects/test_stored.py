"""An extended knee is a subject like any other: its model, its start, its prior, its file."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posed_knees import posed_reference
from small_knee import small_knee, small_protocol
from tolerances import SAME_POSE

from identknee.calibrate.fit import named_start
from identknee.model import laxity_model as joint
from identknee.model.effects.library import choice_of, effect_named, effects_of, library, values_of
from identknee.model.effects.structures import (
    MissingStructure,
    PosteriorCapsule,
    lines_of,
    structure,
)
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import EffectChoice, Knee, Side

PLACE = 1e-9  # mm; roundings of coordinates of several hundred mm


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Knee:
    monkeypatch.setattr(joint, "cache_folder", lambda: tmp_path)
    return small_knee()


def some_amplitudes(knee: Knee, name: str) -> Array:
    parameters = effect_named(knee, name).parameters
    return parameters.center + 0.05 * (parameters.upper - parameters.center)


def extended(knee: Knee, *names: str) -> Knee:
    return knee.with_effects(
        [choice_of(knee, effect_named(knee, x), some_amplitudes(knee, x)) for x in names]
    )


def test_a_stored_model_is_the_one_it_was_made_from(small: Knee) -> None:
    effects = list(library(small))
    effects.append(effect_named(small, "contact_law"))
    amplitudes = [some_amplitudes(small, x.name) for x in effects]
    made = LaxityModel(knee=small, protocol=small_protocol(), effects=tuple(effects))
    theta = np.r_[made.parameters.center[: made.n_ligament_parameters], np.concatenate(amplitudes)]
    stored = LaxityModel(knee=extended(small, *(x.name for x in effects)), protocol=made.protocol)
    assert stored.parameters.names == made.parameters.names
    np.testing.assert_allclose(stored.parameters.start, theta, rtol=1e-12, atol=1e-12)
    for prior in ("center", "lower", "upper", "prior_sd"):
        np.testing.assert_array_equal(
            getattr(stored.parameters, prior), getattr(made.parameters, prior)
        )
    one, other = (x.predict(theta, derivatives=False) for x in (made, stored))
    np.testing.assert_array_equal(one.codes, other.codes)
    same = np.abs(one.coordinates - other.coordinates)[one.is_converged]
    assert same.max(initial=0.0) <= SAME_POSE


def test_the_subject_is_where_searches_start(small: Knee) -> None:
    model = LaxityModel(knee=extended(small, "compression"), protocol=small_protocol())
    parameters, force = model.parameters, some_amplitudes(small, "compression")[0]
    assert named_start("subject", parameters)[-1] == force
    assert parameters.vector({})[-1] == force
    assert parameters.center[-1] == 0.0
    assert parameters.select(["compression.force_N"]).start.tolist() == [force]


def test_a_model_may_leave_the_stored_effects_out_or_add_to_them(small: Knee) -> None:
    knee = extended(small, "compression")
    bare = LaxityModel(knee=knee, protocol=small_protocol(), effects=())
    assert bare.parameters.n == bare.n_ligament_parameters
    model = LaxityModel(knee=knee, protocol=small_protocol())
    more = model.with_effects([*model.effects, effect_named(knee, "toe_strain")])
    assert [x.name for x in more.effects] == ["compression", "toe_strain"]
    assert more.parameters.start[-2] == model.parameters.start[-1]
    assert model.with_effects(()).parameters.n == bare.parameters.n
    assert model.with_protocol(small_protocol().select([0])).effects == model.effects


def test_an_extended_model_goes_to_other_processes(small: Knee) -> None:
    names = [x.name for x in library(small)]
    model = LaxityModel(knee=extended(small, *names), protocol=small_protocol())
    sent: LaxityModel = pickle.loads(pickle.dumps(model))
    start = model.parameters.start
    np.testing.assert_array_equal(sent.parameters.start, start)
    np.testing.assert_array_equal(sent.predict(start).coordinates, model.predict(start).coordinates)


def test_fixed_amplitudes_are_held(small: Knee) -> None:
    names = ("cartilage", "femur_frame")
    knee = extended(small, *names)
    fixed = knee.with_effects(
        [
            choice_of(small, effect_named(small, x), some_amplitudes(small, x), fixed=(amplitude,))
            for x, amplitude in zip(names, ("exponent", "x_deg"), strict=True)
        ]
    )
    free, held = (LaxityModel(knee=x, protocol=small_protocol()) for x in (knee, fixed))
    amplitudes = held.parameters.names[held.n_ligament_parameters :]
    assert amplitudes == ("cartilage.ln_modulus", "femur_frame.y_deg")
    one, other = (x.predict(x.parameters.start) for x in (free, held))
    np.testing.assert_array_equal(one.coordinates, other.coordinates)
    assert one.jacobian is not None
    assert other.jacobian is not None
    kept = [free.parameters.index(x) for x in held.parameters.names]
    np.testing.assert_allclose(one.jacobian[:, :, kept], other.jacobian, rtol=1e-6, atol=1e-9)
    # Stored once more, what was held stays held.
    again = choice_of(fixed, effects_of(fixed)[0], np.array([0.2]))
    assert again.fixed == ("exponent",)
    assert set(again.values) == {"ln_modulus", "exponent"}


@pytest.mark.parametrize("side", ["left", "right"])
def test_structures_stand_where_they_stood(tmp_path: Path, side: Side) -> None:
    knee = posed_reference(6, side=side, edge_mm=3.0)
    capsule = effect_named(knee, "posterior_capsule")
    line = structure(knee, "missing_line", [_a_line(knee)], stiffness_sd=0.7, site_sd=9.0)
    choices = [choice_of(knee, x, x.parameters.upper) for x in (capsule, line)]
    read = read_subject(write_subject(knee.with_effects(choices), tmp_path))
    for made, again in zip((capsule, line), effects_of(read), strict=True):
        assert isinstance(again, MissingStructure | PosteriorCapsule)
        assert isinstance(made, MissingStructure | PosteriorCapsule)
        assert again.parameters.names == made.parameters.names
        np.testing.assert_array_equal(again.parameters.prior_sd, made.parameters.prior_sd)
        np.testing.assert_allclose(lines_of(read, again), lines_of(knee, made), atol=PLACE)
        own = [values_of(read)[x] for x in made.parameters.names]
        np.testing.assert_array_equal(own, made.parameters.upper)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        (EffectChoice(name="compresion"), "Did you mean compression"),
        (EffectChoice(name="compression", values={"force": 1.0}), "Did you mean force_N"),
        (EffectChoice(name="compression", values={"force_N": 1e4}), "must be within -60 to 300"),
    ],
    ids=["effect", "amplitude", "range"],
)
def test_what_is_no_effect_is_refused(small: Knee, choice: EffectChoice, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LaxityModel(knee=small.with_effects([choice]), protocol=small_protocol())


def _a_line(knee: Knee) -> tuple[Array, Array]:
    return knee.femur_frame.to_common([5.0, 3.0, 35.0]), knee.tibia_frame.to_common([9, -30, 30])


def test_an_effect_with_all_its_amplitudes_fixed_has_nothing_to_search(small: Knee) -> None:
    choice = EffectChoice(name="compression", values={"force_N": 20.0}, fixed=("force_N",))
    assert values_of(replace(small, effects=(choice,))) == {}
