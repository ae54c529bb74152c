"""Moving insertions within their uncertainty until all trials have an equilibrium."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from identknee.model.effects.tissues import SHIFT_LIMIT, insertion
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, array, declared, entry
from identknee.runs.executors import Executor, serial
from identknee.subject.knee import BONES, Knee

# Names of the negative and the positive direction along each axis of a bone's frame.
DIRECTIONS = (("posteriorly", "anteriorly"), ("distally", "proximally"), ("medially", "laterally"))
# Default distance by which insertions may move, an error of segmentation [mm].
WITHIN = 3.0
# Steps of the search as shares of that distance; the later ones are tried only if none of the first
# gains.
STEPS = (1.0 / 3.0, 2.0 / 3.0, 1.0 / 6.0)
MOST_ROUNDS = 40
# Stability margin below which a small change may end a branch, and equilibria found from other
# starts may differ by more than 1e-9 [N/mm].
ENOUGH_MARGIN = 0.5

Score = tuple[int, float, float]


@declared
class InsertionMove:
    """One insertion moved along an axis of its bone's frame, and the gain."""

    ligament: str = entry("Ligament whose insertion is moved")
    bone: str = entry("Bone of the insertion, femur or tibia")
    direction: str = entry("Direction along an axis of the bone's frame, such as anteriorly")
    distance_mm: float = entry("How far the insertion is moved", unit="mm")
    n_restored: int = entry(
        "Trials that converge then, less those that converge without; negative where it loses some",
        unit="1",
    )

    @property
    def words(self) -> str:
        """The move in words, such as ``ACL on the femur 3 mm anteriorly``."""
        return f"{self.ligament} on the {self.bone} {self.distance_mm:g} mm {self.direction}"


@declared
class MovedInsertion:
    """An insertion with its displacement."""

    ligament: str = entry("Ligament whose insertion moved")
    bone: str = entry("Bone of the insertion, femur or tibia")
    distance_mm: float = entry("How far the insertion moved", unit="mm")
    shift_mm: Array = array(
        "Shift along x, y and z of the bone's frame", "axis", unit="mm", is_in_json=True
    )

    @property
    def words(self) -> str:
        """The move in words, such as ``ACL on the femur moved 5.0 mm (5.0 mm anteriorly)``."""
        parts = [
            f"{abs(x):.1f} mm {names[int(x > 0.0)]}"
            for x, names in zip(self.shift_mm, DIRECTIONS, strict=True)
            if x != 0.0
        ]
        moved = f"{self.ligament} on the {self.bone} moved {self.distance_mm:.1f} mm"
        return f"{moved} ({', '.join(parts)})"


@declared
class SettledKnee:
    """A knee with insertions moved until its trials converge or no move helps."""

    knee: Knee = entry("The subject with the insertions moved")
    moved: tuple[MovedInsertion, ...] = entry("The insertions that moved")
    n_trials: int = entry("Trials of the protocol")
    n_before: int = entry("How many converge before")
    n_after: int = entry("How many converge after")
    lowest_margin: float = entry("Lowest margin of the trials that converge after [N/mm]")


def rank_moves(
    model: LaxityModel, *, within_mm: float = WITHIN, executor: Executor = serial
) -> tuple[InsertionMove, ...]:
    """All moves of one insertion by `within_mm` along an axis, the most effective first.

    They are ranked by the number of trials that they restore, then by the share of the load that
    the lost trials reach.

    Raises
    ------
    ValueError
        If the distance is not between 0 and 8 mm.
    """
    search = _Search(model, within_mm, executor)
    none = search.nowhere()
    before = search.scores([none])[0]
    steps = list(search.steps(within_mm))
    scores = search.scores([none + x for x in steps])
    ranked = sorted(zip(scores, steps, strict=True), key=lambda x: x[0], reverse=True)
    return tuple(search.move(step, score[0] - before[0]) for score, step in ranked)


def settle(
    model: LaxityModel, *, within_mm: float = WITHIN, executor: Executor = serial
) -> SettledKnee:
    """The knee with insertions moved, step by step, until all trials converge with a margin.

    Each step is the one that restores most. At the end insertions that need not have moved are put
    back. If no step helps before all trials converge, the result is the best knee found.

    Raises
    ------
    ValueError
        If the distance is not between 0 and 8 mm.
    """
    search = _Search(model, within_mm, executor)
    shifts = search.nowhere()
    score = before = search.scores([shifts])[0]
    for _ in range(MOST_ROUNDS):
        found = None if search.is_enough(score) else search.better(shifts, score)
        if found is None:
            break
        shifts, score = found
    shifts, score = search.fewest(shifts, score)
    femur, tibia = model.knee.femur_frame, model.knee.tibia_frame
    ligaments = [
        replace(
            x,
            femur=femur.to_common(femur.to_local(x.femur) + own[0]),
            tibia=tibia.to_common(tibia.to_local(x.tibia) + own[1]),
        )
        for x, own in zip(model.knee.ligaments, shifts, strict=True)
    ]
    return SettledKnee(
        knee=model.knee.with_ligaments(ligaments),
        moved=tuple(
            MovedInsertion(
                ligament=ligament.name,
                bone=bone,
                distance_mm=float(np.linalg.norm(shift)),
                shift_mm=shift,
            )
            for ligament, own in zip(model.knee.ligaments, shifts, strict=True)
            for bone, shift in zip(BONES, own, strict=True)
            if shift.any()
        ),
        n_trials=model.protocol.n,
        n_before=before[0],
        n_after=score[0],
        lowest_margin=search.lowest_margin(shifts),
    )


class _Search:
    """Predictions of one model at shifted insertions."""

    def __init__(self, model: LaxityModel, within_mm: float, executor: Executor) -> None:
        if not 0.0 < within_mm <= SHIFT_LIMIT:
            raise ValueError(
                f"insertions may be moved by more than 0 and at most {SHIFT_LIMIT:g} mm, got "
                f"{within_mm:g} mm"
            )
        self._within, self._executor = within_mm, executor
        effect = insertion(model.knee)
        kept = [x for x in model.effects if x.name != effect.name]
        self._model = model.with_effects([*kept, effect])
        self._ligaments = model.knee.ligaments

    def nowhere(self) -> Array:
        return np.zeros((len(self._ligaments), 2, 3))

    def steps(self, size: float) -> Iterable[Array]:
        for i in range(len(self._ligaments)):
            for bone in range(2):
                for axis in range(3):
                    for sign in (-1.0, 1.0):
                        step = self.nowhere()
                        step[i, bone, axis] = sign * size
                        yield step

    def move(self, step: Array, n_restored: int) -> InsertionMove:
        i, bone, axis = (int(x[0]) for x in np.nonzero(step))
        value = float(step[i, bone, axis])
        return InsertionMove(
            ligament=self._ligaments[i].name,
            bone=BONES[bone],
            direction=DIRECTIONS[axis][int(value > 0.0)],
            distance_mm=abs(value),
            n_restored=n_restored,
        )

    def better(self, shifts: Array, score: Score) -> tuple[Array, Score] | None:
        """The shifts after the most effective step; None if no step gains."""
        for size in STEPS:
            tried = [shifts + step for step in self.steps(size * self._within)]
            farthest = self._within * (1.0 + 1e-9)
            tried = [x for x in tried if np.all(np.linalg.norm(x, axis=2) <= farthest)]
            found = self.scores(tried)
            best = max(range(len(tried)), key=lambda k: found[k])
            if found[best] > score:
                return tried[best], found[best]
        return None

    def is_enough(self, score: Score) -> bool:
        return score[0] == self._model.protocol.n and score[2] >= ENOUGH_MARGIN

    def scores(self, shifts: Sequence[Array]) -> list[Score]:
        """Number of converged trials, summed share of load of the others, and lowest margin."""
        scores = []
        for found in self._executor.map(partial(_predict, self._model), shifts):
            converged = found.is_converged
            margins = found.margins[converged]
            # The margin counts up to what is enough and only where no trial is lost.
            margin = min(float(margins.min()), ENOUGH_MARGIN) if converged.all() else 0.0
            reached = float(found.reached[~converged].sum())
            scores.append((int(converged.sum()), reached, margin))
        return scores

    def lowest_margin(self, shifts: Array) -> float:
        found = _predict(self._model, shifts)
        margins = found.margins[found.is_converged]
        return float(margins.min()) if margins.size else float("nan")

    def fewest(self, shifts: Array, score: Score) -> tuple[Array, Score]:
        """The shifts without those that are not needed."""
        for place in sorted(np.ndindex(shifts.shape[:2]), key=lambda x: np.linalg.norm(shifts[x])):
            if not shifts[place].any():
                continue
            without = np.array(shifts)
            without[place] = 0.0
            found = self.scores([without])[0]
            if self.is_enough(found) or found >= score:
                shifts, score = without, found
        return shifts, score


def _predict(model: LaxityModel, shifts: Array) -> Prediction:
    theta = np.array(model.parameters.start)
    theta[-shifts.size :] += shifts.ravel()
    return model.predict(theta, derivatives=False)
