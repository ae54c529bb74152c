"""Insertions moved within their uncertainty, against knees built with them."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.protocol import load_protocol
from identknee.model.insertion_moves import InsertionMove, rank_moves, settle
from identknee.model.laxity_model import LaxityModel
from identknee.subject.folder import example
from identknee.subject.knee import Knee

FOLDING = "lenhart2015"
# Of a right knee: x anterior, y superior, z lateral.
WAYS = {
    "anteriorly": (0, 1.0),
    "posteriorly": (0, -1.0),
    "proximally": (1, 1.0),
    "distally": (1, -1.0),
    "laterally": (2, 1.0),
    "medially": (2, -1.0),
}


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    """A real knee that folds, under the moments about the tibia's axis."""
    protocol = load_protocol("seed63")
    turned = np.flatnonzero((protocol.loads[:, 0] > 0) & (protocol.flexion_deg < 60))
    return LaxityModel(knee=example(FOLDING), protocol=protocol.select(turned))


def converged(knee: Knee, model: LaxityModel) -> int:
    built = LaxityModel(knee=knee, protocol=model.protocol)
    return int(built.predict(built.parameters.start, derivatives=False).is_converged.sum())


def built(knee: Knee, move: InsertionMove) -> Knee:
    """The knee with one insertion moved as the words say, by plain geometry."""
    axis, sign = WAYS[move.direction]
    frame = knee.femur_frame if move.bone == "femur" else knee.tibia_frame
    ligaments = []
    for x in knee.ligaments:
        if x.name == move.ligament:
            shift = sign * move.distance_mm * frame.axes[:, axis]
            x = replace(x, **{move.bone: getattr(x, move.bone) + shift})
        ligaments.append(x)
    return knee.with_ligaments(ligaments)


def test_a_move_restores_what_it_says(model: LaxityModel) -> None:
    before = converged(model.knee, model)
    assert before < model.protocol.n
    moves = rank_moves(model, within_mm=3.0)
    assert len(moves) == 4 * 2 * 3 * 2
    gains = [x.n_restored for x in moves]
    assert gains == sorted(gains, reverse=True)
    # Of each direction the move that changes most, and one that changes nothing.
    telling = [
        max((x for x in moves if x.direction == way), key=lambda x: abs(x.n_restored))
        for way in WAYS
    ]
    assert gains[0] > 0 > gains[-1]
    # Along every axis of the bones one way at least changes something.
    ways = {x.direction for x in telling if x.n_restored != 0}
    assert {WAYS[x][0] for x in ways} == {0, 1, 2}
    idle = next(x for x in moves if x.n_restored == 0)
    for move in (*telling, idle):
        assert converged(built(model.knee, move), model) - before == move.n_restored
    best = moves[0]
    assert (best.ligament, best.bone, best.distance_mm, best.direction) == (
        *("ACL", "femur"),
        *(3.0, "laterally"),
    )
    parts = (best.ligament, best.bone, "3 mm", best.direction)
    assert [x for x in parts if x not in best.words] == []


def test_a_knee_settles_within_its_uncertainty(model: LaxityModel) -> None:
    found = settle(model, within_mm=5.0)
    assert found.n_before == converged(model.knee, model)
    assert found.n_after == model.protocol.n == converged(found.knee, model)
    assert found.lowest_margin >= 0.5
    sizes = [x.distance_mm for x in found.moved]
    assert sizes == [np.linalg.norm(x.shift_mm) for x in found.moved]
    assert 0.0 < max(sizes) <= 5.0 * (1 + 1e-9)
    # No insertion is moved that may stay.
    names = [x.name for x in model.knee.ligaments]
    for moved in found.moved:
        i = names.index(moved.ligament)
        given = getattr(model.knee.ligaments[i], moved.bone)
        shifted = getattr(found.knee.ligaments[i], moved.bone)
        assert np.linalg.norm(shifted - given) == pytest.approx(moved.distance_mm, abs=1e-9)
        back = replace(found.knee.ligaments[i], **{moved.bone: given})
        others = [back if x.name == back.name else x for x in found.knee.ligaments]
        rebuilt = LaxityModel(knee=model.knee.with_ligaments(others), protocol=model.protocol)
        prediction = rebuilt.predict(rebuilt.parameters.start, derivatives=False)
        margin = prediction.margins[prediction.is_converged].min()
        assert not prediction.all_converged or margin < 0.5


def test_a_knee_that_is_stable_stays_as_it_is(model: LaxityModel) -> None:
    stable = LaxityModel(knee=example("lenhart2015_stable"), protocol=model.protocol)
    found = settle(stable)
    assert found.n_before == found.n_after == model.protocol.n
    assert found.moved == ()


@pytest.mark.parametrize("within", [0.0, -1.0, 8.5, np.nan])
def test_a_distance_beyond_the_range_is_refused(model: LaxityModel, within: float) -> None:
    with pytest.raises(ValueError, match=f"8 mm, got {within:g}"):
        rank_moves(model, within_mm=within)
