"""States in tables and protocols, several tables as one laxity, and experiments.toml."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.laxity.experiment_tables import joined, read_experiments
from identknee.laxity.experiments import Experiment, cuts_of, state_words
from identknee.laxity.protocol import candidate_trials, concatenate, from_zero, opposite_pairs

PROTOCOL = ik.load_protocol("drawer")


def _table(
    name: str, value: float = 1.0, *, state: str | None = None, sd: bool = True
) -> ik.Laxity:
    n = PROTOCOL.n
    coordinates = value + np.arange(5.0 * n).reshape(n, 5) / 100.0
    protocol = replace(PROTOCOL, name=name, state=None if state is None else (state,) * n)
    return ik.Laxity(
        protocol=protocol,
        coordinates=coordinates,
        sd=np.full((n, 5), 0.5) if sd else None,
    )


@pytest.mark.parametrize(
    ("state", "cuts", "words"),
    [
        ("intact", [], "intact"),
        ("", [], "intact"),
        (" Cut: ACL ", [("ACL", 1.0)], "cut: ACL"),
        ("cut:PCL,ACL", [("PCL", 1.0), ("ACL", 1.0)], "cut: ACL, PCL"),
        ("cut: ACL 50%, dMCL 12.5 %", [("ACL", 0.5), ("dMCL", 0.125)], "cut: ACL 50%, dMCL 12.5%"),
        ("ACL cut", [("ACL", 1.0)], "cut: ACL"),
        ("ACL-deficient", [("ACL", 1.0)], "cut: ACL"),
        ("cut: ACL 100%", [("ACL", 1.0)], "cut: ACL"),
        ("cut ACL", [("ACL", 1.0)], "cut: ACL"),
        ("without ACL and MCL", [("ACL", 1.0), ("MCL", 1.0)], "cut: ACL, MCL"),
        ("ACL_transected", [("ACL", 1.0)], "cut: ACL"),
        ("Native knee", [], "intact"),
    ],
)
def test_a_state_has_one_form(state: str, cuts: list[tuple[str, float]], words: str) -> None:
    found = cuts_of(state)
    assert [(x.ligament, x.fraction) for x in found] == cuts
    assert state_words(found) == words
    assert state_words(cuts_of(words)) == words


@pytest.mark.parametrize(
    "state",
    [
        "cut:",
        "severed",
        "ACL torn",
        "knee",
        "ACL",
        "cut: ACL 0%",
        "cut: ACL 120%",
        "cut: ACL, ACL",
        "cut: ,ACL",
    ],
)
def test_other_states_are_refused(state: str) -> None:
    with pytest.raises(ValueError, match="state"):
        cuts_of(state)


def test_a_column_of_states_is_read_and_written(tmp_path: Path) -> None:
    states = ("intact",) * 4 + ("cut: ACL",) * (PROTOCOL.n - 4)
    table = replace(_table("a"), protocol=replace(PROTOCOL, state=states))
    path = ik.write_laxity(table, tmp_path / "a.csv")
    again = ik.read_laxity(path)
    assert again.protocol.state == states
    assert again.select([0, 5]).protocol.state == ("intact", "cut: ACL")
    # Where nothing is cut there is no state.
    whole = replace(table, protocol=replace(PROTOCOL, state=("intact",) * PROTOCOL.n))
    assert whole.protocol.state is None
    text = path.read_text().replace("cut: ACL", "severed")
    path.write_text(text)
    with pytest.raises(ik.InputError, match="severed") as caught:
        ik.read_laxity(path)
    assert caught.value.where == "row 6, column state"


def test_a_protocol_has_states(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(
        'format = 1\n[[ramps]]\nload = "anterior_force_N"\nflexion_deg = 30\nvalues = [0, 100]\n'
        '[[ramps]]\nstate = "cut: ACL"\nload = "anterior_force_N"\nflexion_deg = 30\n'
        "values = [0, 100]\n"
    )
    protocol = ik.load_protocol(path)
    assert protocol.state == ("intact", "intact", "cut: ACL", "cut: ACL")
    assert protocol.trials[2:] == ("flexion30_unloaded_cut_ACL", "flexion30_anterior100N_cut_ACL")
    path.write_text(path.read_text().replace("cut: ACL", "gone"))
    with pytest.raises(ik.InputError, match="gone") as caught:
        ik.load_protocol(path)
    assert caught.value.where.endswith(" block 2, state")


def test_changes_are_counted_within_one_experiment_and_state() -> None:
    laxity = joined(
        [
            (Experiment(name=x, rig="rig", mounting="rig-1"), _table(x, value, state=state))
            for x, value, state in (("a", 1.0, None), ("b", 50.0, "cut: ACL"))
        ]
    )
    protocol = laxity.protocol
    assert protocol.series.tolist() == [0] * PROTOCOL.n + [1] * PROTOCOL.n
    for zero in ("unloaded", "opposite"):
        changes = from_zero(laxity.coordinates, protocol, zero)
        own = from_zero(_table("a").coordinates, PROTOCOL, zero)
        np.testing.assert_allclose(changes, np.vstack([own, own]), atol=1e-12)
    pairs = opposite_pairs(protocol)
    np.testing.assert_array_equal(pairs[:, 0] < PROTOCOL.n, pairs[:, 1] < PROTOCOL.n)


def test_several_tables_are_one_laxity(tmp_path: Path) -> None:
    paths = [ik.write_laxity(_table(x, i), tmp_path / f"{x}.csv") for i, x in enumerate("ab")]
    laxity = read_experiments(paths)
    assert laxity.protocol.trials[:: PROTOCOL.n] == ("a/flexion0_anterior-100N",) * 1 + (
        "b/flexion0_anterior-100N",
    )
    assert {x.mounting for x in laxity.protocol.experiments} == {"rig-1"}
    np.testing.assert_array_equal(laxity.coordinates[PROTOCOL.n :], _table("b", 1).coordinates)
    # Names that differ stay as they are.
    trials = tuple(f"{x}_again" for x in PROTOCOL.trials)
    other = replace(_table("b"), protocol=replace(PROTOCOL, name="b", trials=trials))
    assert read_experiments([_table("a"), other]).protocol.trials == (*PROTOCOL.trials, *trials)
    assert read_experiments([paths[0]]).protocol.experiment is None


def test_experiments_toml_says_rig_mounting_state_and_noise(tmp_path: Path) -> None:
    for x in ("a", "b", "c"):
        ik.write_laxity(_table(x, sd=False), tmp_path / f"{x}.csv")
    path = tmp_path / "experiments.toml"
    path.write_text(
        '[[experiments]]\nname = "a"\ntable = "a.csv"\nrig = "robot"\n'
        '[[experiments]]\nname = "b"\ntable = "b.csv"\nrig = "robot"\nremounted = true\n'
        'state = "cut: ACL"\n'
        '[[experiments]]\nname = "c"\ntable = "c.csv"\nrig = "hand"\n'
        '[rigs.robot]\nnoise = "0.5mm,1deg"\n[rigs.robot.uncertainty]\nregistration_deg = 2.0\n'
        '[rigs.hand]\nnoise = "2mm,3deg"\n'
    )
    laxity = read_experiments(path)
    assert [(x.rig, x.mounting) for x in laxity.protocol.experiments] == [
        ("robot", "robot-1"),
        ("robot", "robot-2"),
        ("hand", "hand-1"),
    ]
    assert laxity.protocol.mounting.tolist() == [i for i in range(3) for _ in range(PROTOCOL.n)]
    assert laxity.protocol.experiments[0].uncertainty == {"registration_deg": 2.0}
    assert laxity.sd is not None
    assert laxity.sd[0].tolist() == [0.5] * 3 + [1.0] * 2
    assert laxity.sd[-1].tolist() == [2.0] * 3 + [3.0] * 2
    assert laxity.protocol.state == ("intact",) * 9 + ("cut: ACL",) * 9 + ("intact",) * 9


def test_an_experiment_may_be_a_table_that_comes_with_identknee(tmp_path: Path) -> None:
    path = tmp_path / "experiments.toml"
    path.write_text('[[experiments]]\nname = "robot"\ntable = "s192803"\n')
    named = ik.read_laxity("s192803")
    np.testing.assert_array_equal(read_experiments(path).coordinates, named.coordinates)


WRONG = {
    "the rig of no experiment": ("[rigs.other]\n", "other"),
    "an error of the knee": ("[rigs.rig.uncertainty]\ninsertions_mm = 2.0\n", "insertions_mm"),
    "no size of noise": ('[rigs.rig]\nnoise = "much"\n', "much"),
    "no size of noise beside a table's own": (
        '[[experiments]]\nname = "x"\ntable = "sd.csv"\nrig = "b"\n[rigs.b]\nnoise = "much"\n',
        "much",
    ),
    "an unknown word": ("[rigs.rig]\nnois = 1\n", "nois"),
    "one name twice": ('[[experiments]]\nname = "a"\ntable = "a.csv"\n', "two experiments"),
    "no table": ('[[experiments]]\nname = "x"\ntable = "none.csv"\n', "none.csv"),
    "another noise": ('[[experiments]]\nname = "x"\ntable = "sd.csv"\n', "states no noise"),
    "another zero": ('[[experiments]]\nname = "x"\ntable = "zero.csv"\n', "unloaded"),
    "two states": ('[[experiments]]\nname = "x"\ntable = "cut.csv"\nstate = "cut: MCL"\n', "MCL"),
    "no name": ('[[experiments]]\nname = "a/b"\ntable = "a.csv"\n', "a/b"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    ik.write_laxity(_table("a", sd=False), tmp_path / "a.csv")
    ik.write_laxity(_table("sd"), tmp_path / "sd.csv")
    ik.write_laxity(_table("cut", state="cut: ACL", sd=False), tmp_path / "cut.csv")
    relative = replace(_table("zero", sd=False), zero="unloaded")
    ik.write_laxity(relative, tmp_path / "zero.csv")
    path = tmp_path / "experiments.toml"
    text, named = WRONG[case]
    path.write_text(f'[[experiments]]\nname = "a"\ntable = "a.csv"\n{text}')
    with pytest.raises(ValueError, match=named):
        read_experiments(path)


def test_trials_are_appended_with_their_state() -> None:
    cut = replace(
        PROTOCOL,
        trials=tuple(f"{x}_cut" for x in PROTOCOL.trials),
        state=("cut: ACL",) * PROTOCOL.n,
    )
    both = concatenate([PROTOCOL, cut])
    assert both.state == ("intact",) * PROTOCOL.n + ("cut: ACL",) * PROTOCOL.n
    with pytest.raises(ValueError, match=re.escape(repr(PROTOCOL.trials[0]))):
        concatenate([PROTOCOL, replace(PROTOCOL, state=("cut: ACL",) * PROTOCOL.n)])
    assert candidate_trials(both, [0]).n > both.n


def test_trials_to_add_are_of_the_experiment_where_the_knee_was_left() -> None:
    tables = [("robot", "cut: ACL"), ("hand", None)]
    made = joined(
        [
            (Experiment(name=name, rig=name, mounting=name), _table(name, state=state))
            for name, state in tables
        ]
    ).protocol
    offered = candidate_trials(made, [0])
    assert set(offered.states) == {"cut: ACL"}
    assert set(offered.experiment or ()) == {"robot"}
    repeats = set(offered.trials) & set(made.trials)
    assert repeats == {x for x in made.trials if x.startswith("robot/")}
    both = concatenate([made, offered])
    assert both.n == made.n + offered.n - len(repeats)
    assert both.experiments == made.experiments
