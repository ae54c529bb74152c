"""Steps beside one more laxity trial: a cut and a trial in that state, and forces in a trial."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.laxity.experiments import Cut, cuts_of, state_words
from identknee.laxity.protocol import (
    LOADS,
    Protocol,
    dominant_loads,
    nominal_flexion,
    nominal_held_loads,
)
from identknee.model.candidate_laxity import CandidateLaxity, continued_from_own_poses
from identknee.model.contact_loads import contact_jacobian, contact_values
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_loads, structure_names
from identknee.model.parameters import FreeParameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry

# Standard deviations of a force found by superposition and of a film's reading [N]. A replayed pose
# is good to some hundredths of a millimetre, and films to about a tenth of some hundred newtons:
# both are estimates.
TENSION_SD, CONTACT_SD = 5.0, 20.0
N_VALUES = 2


def current_state(protocol: Protocol) -> str:
    """The state with the most cuts, in which the knee is left: a cut is final."""
    states = protocol.state or ("intact",)
    return max(reversed(states), key=lambda x: len(cuts_of(x)))


def with_state(protocol: Protocol, state: str) -> Protocol:
    """All trials of a protocol in one state."""
    return replace(protocol, state=(state,) * protocol.n)


def state_after(state: str, ligament: str) -> str:
    """The state once one more ligament or group is cut.

    Examples
    --------
    >>> state_after("cut: ACL", "LCL")
    'cut: ACL, LCL'
    """
    made = [x for x in cuts_of(state) if x.ligament != ligament]
    return state_words([*made, Cut(ligament=ligament, fraction=1.0)])


def strongest_trials(protocol: Protocol, held: Sequence[float] = (0.0,) * len(LOADS)) -> Protocol:
    """Of the trials with one load beside those held, the largest each way at each flexion angle.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> strongest_trials(load_protocol("seed63")).n
    12
    """
    dominant, flexion = dominant_loads(protocol), nominal_flexion(protocol)
    is_single = np.count_nonzero(protocol.loads - np.asarray(held), axis=1) == 1
    best: dict[tuple[float, int, float], int] = {}
    for i in np.flatnonzero(is_single).tolist():
        size = float(dominant.size[i])
        key = (float(flexion[i]), int(dominant.axis[i]), float(np.sign(size)))
        if key not in best or abs(size) > abs(float(dominant.size[best[key]])):
            best[key] = i
    return protocol.select(sorted(best.values()))


def structures_left(model: LaxityModel, state: str) -> tuple[str, ...]:
    """Ligaments and groups of the knee that are not cut through in a state."""
    gone = {x.ligament for x in cuts_of(state) if not x.is_partial}
    members = {x.name: set(x.members) for x in model.knee.groups}
    return tuple(x for x in model.tied.names if x not in gone and not members.get(x, {x}) & gone)


@declared
class LaxityAfterCut:
    """Trials in the state after one more cut."""

    ligament: str = entry("The ligament or group that is cut")
    trials: tuple[str, ...] = entry("Names of the trials before the cut")
    laxity: CandidateLaxity = entry("The trials after it")


def trials_made_again(offered: CandidateLaxity) -> Protocol:
    """The strongest of the trials that were made; of all offered where none of these has one load.

    A trial that was made is offered as it was meant, at the same nominal angle and load.
    """
    made, trials = offered.laxity.protocol, offered.protocol
    flexion, dominant = np.round(nominal_flexion(made)), dominant_loads(made)
    kinds = {*zip(flexion, dominant.axis, np.sign(dominant.size), strict=True)}
    own = dominant_loads(trials)
    of = zip(np.round(trials.flexion_deg), own.axis, np.sign(own.size), strict=True)
    again = trials.select([i for i, kind in enumerate(of) if kind in kinds])
    held = nominal_held_loads(made)
    strongest = strongest_trials(again, held)
    return strongest if strongest.n else strongest_trials(trials, held)


def laxity_after_cuts(offered: CandidateLaxity, state: str) -> tuple[LaxityAfterCut, ...]:
    """The strongest trials made, once more after each cut that may follow."""
    trials = trials_made_again(offered)
    left = structures_left(offered.model, state)
    found = []
    for ligament in left if len(left) > 1 else ():
        names = tuple(f"{x} without {ligament}" for x in trials.trials)
        cut = with_state(replace(trials, trials=names), state_after(state, ligament))
        laxity = replace(offered, protocol=cut)
        found.append(LaxityAfterCut(ligament=ligament, trials=trials.trials, laxity=laxity))
    return tuple(found)


@declared
class CandidateForces:
    """Forces that may be measured in trials: the tension of a structure, or the contact forces.

    A trial has one candidate for each structure, then one for both compartments.
    """

    model: LaxityModel = entry("The model under the trials, from the poses at which they begin")
    free: FreeParameters = entry("The parameters that vary, and the values of the others")
    structures: tuple[str, ...] = entry("Ligaments and groups whose tension may be measured")
    has_contact: bool = entry("Whether contact forces may be measured")

    @property
    def places(self) -> list[tuple[int, str]]:
        """Trial and structure of each candidate; no name for the contact forces."""
        kinds = (*self.structures, *([""] if self.has_contact else []))
        return [(i, x) for i in range(self.model.protocol.n) for x in kinds]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        trials = self.model.protocol.trials
        return tuple(
            f"tension of {x} in {trials[i]}" if x else f"contact forces in {trials[i]}"
            for i, x in self.places
        )

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """The forces in units of their errors and their derivatives, ``(k, 2)``, ``(k, 2, n)``.

        A tension has one value; the second is 0 whatever the parameters. NaN in a trial without
        equilibrium.
        """
        found = self.model.predict(self.free.expand(theta))
        trials = range(self.model.protocol.n)
        loads = structure_loads(self.model, found)
        columns = [structure_names(self.model).index(x) for x in self.structures]
        m = len(columns)
        by_theta = self.free.restrict(loads.tension_jacobian)
        values = np.zeros((len(trials), m + self.has_contact, N_VALUES))
        jacobians = np.zeros((*values.shape, by_theta.shape[-1]))
        values[:, :m, 0] = loads.tensions[:, columns] / TENSION_SD
        jacobians[:, :m, 0] = by_theta[:, columns] / TENSION_SD
        if self.has_contact:
            slopes = contact_jacobian(self.model, found, trials)[:, :, 0]
            values[:, m] = contact_values(found)[:, :, 0] / CONTACT_SD
            jacobians[:, m] = self.free.restrict(slopes) / CONTACT_SD
        is_lost = ~found.is_converged
        values[is_lost], jacobians[is_lost] = np.nan, np.nan
        k = list(chosen)
        return values.reshape(-1, N_VALUES)[k], jacobians.reshape(-1, *jacobians.shape[2:])[k]

    def with_start_poses(self, theta: Array) -> "CandidateForces":
        """The same, its trials followed from the poses that the model has at `theta`."""
        return replace(self, model=continued_from_own_poses(self.model, self.free.expand(theta)))


def candidate_forces(
    offered: CandidateLaxity, state: str, *, has_tensions: bool, has_contact: bool
) -> CandidateForces:
    """Forces in the strongest trials made, once more, of the structures that are left."""
    trials = with_state(trials_made_again(offered), state)
    return CandidateForces(
        model=offered.model.with_protocol(trials),
        free=offered.free,
        structures=structures_left(offered.model, state) if has_tensions else (),
        has_contact=has_contact,
    )
