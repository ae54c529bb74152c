"""Trials that could be added to a laxity test, to be chosen from."""

from collections.abc import Mapping, Sequence

import numpy as np

from identknee.laxity.protocol import LOADS, Protocol, trial_name

FLEXION_DEG = tuple(range(0, 121, 15))
# What rigs and examiners apply: drawer, varus/valgus and internal/external tests one at a time, on
# a compressed or distracted knee, and in pairs.
SINGLE: tuple[Mapping[str, float], ...] = (
    {},
    *({"internal_moment_Nm": x} for x in (-10.0, -5.0, 5.0, 10.0)),
    *({"varus_moment_Nm": x} for x in (-10.0, 10.0)),
    *({"anterior_force_N": x} for x in (-100.0, 134.0)),
    *({"distraction_force_N": x} for x in (-250.0, 100.0)),
)
COMBINED: tuple[Mapping[str, float], ...] = (
    *({"internal_moment_Nm": x, "varus_moment_Nm": y} for x in (-5.0, 5.0) for y in (-10.0, 10.0)),
    *(
        {"internal_moment_Nm": x, "anterior_force_N": y}
        for x in (-5.0, 5.0)
        for y in (-100.0, 134.0)
    ),
    *({"internal_moment_Nm": x, "distraction_force_N": -250.0} for x in (-5.0, 5.0)),
    *({"anterior_force_N": x, "distraction_force_N": -250.0} for x in (-100.0, 134.0)),
)


def candidate_trials(made: Protocol, flexion_deg: Sequence[float] = FLEXION_DEG) -> Protocol:
    """Trials that might be added to those made: single loads, combined loads and repeats.

    At each flexion angle the unloaded knee, internal and external moments of 5 and 10 N·m, varus
    and valgus of 10 N·m, anterior 134 N, posterior 100 N, compression 250 N, distraction 100 N, and
    pairs of them; and every trial made already, once more.

    Parameters
    ----------
    made
        The trials made. A candidate with the angle and the loads of one of them is its repeat and
        bears its name.
    flexion_deg
        Angles of the new ones [deg].

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> candidates = candidate_trials(load_protocol("seed63"), [0, 90])
    >>> candidates.n, candidates.trials[63]
    (104, 'flexion0_internal-5Nm')
    """
    trials = zip(made.trials, made.flexion_deg, made.loads, strict=True)
    rows = {_key(a, x): (t, float(a), x) for t, a, x in trials}
    taken = set(made.trials)
    for angle in flexion_deg:
        for loads in (*SINGLE, *COMBINED):
            values = np.array([loads.get(column, 0.0) for column in LOADS])
            name = trial_name(angle, values.tolist())
            # A trial made under this name may have other loads.
            while name in taken and _key(angle, values) not in rows:
                name += "_new"
            rows.setdefault(_key(angle, values), (name, float(angle), values))
            taken.add(name)
    names, angles, values_of = zip(*rows.values(), strict=True)
    return Protocol(
        name=f"candidates for {made.name}",
        trials=names,
        flexion_deg=np.array(angles),
        loads=np.array(values_of),
    )


def unique_names(names: Sequence[str], taken: Sequence[str]) -> tuple[str, ...]:
    """The names, with a number added to those that are taken or come again.

    Examples
    --------
    >>> unique_names(["a", "b", "a"], taken=["b"])
    ('a', 'b_repeat2', 'a_repeat2')
    """
    used = set(taken)
    given = []
    for name in names:
        new, number = name, 1
        while new in used:
            number += 1
            new = f"{name}_repeat{number}"
        used.add(new)
        given.append(new)
    return tuple(given)


def _key(angle: float, loads: np.ndarray) -> tuple[float, ...]:
    return (float(angle), *(loads + 0.0).tolist())
