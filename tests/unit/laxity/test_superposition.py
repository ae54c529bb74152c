"""Tables of in-situ forces: what they hold, how they are read, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.laxity.experiment_tables import joined, read_experiments
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import Superposition, read_superposition, write_superposition

HEADER = (
    "trial,cut,before,after,force_x_N,force_y_N,force_z_N,sd_force_x_N,sd_force_y_N,sd_force_z_N\n"
)
ROWS = 'a,ACL,intact,cut: ACL,-10,100,5,4,4,4\na,MCL,cut: ACL,"cut: ACL, MCL",0,50,,4,4,\n'
TABLE = "trial,flexion_deg,varus_deg,sd_varus_deg,state\na,30,1,0.5,\nb,60,1,0.5,\n"
TOML = """
[[experiments]]
name = "tests"
table = "tests.csv"
[[experiments]]
name = "insitu"
superposition = "insitu.csv"
reads = "load on tibia"
"""


def _written(folder: Path, text: str) -> Path:
    path = folder / "insitu.csv"
    path.write_text(text)
    return path


def test_a_table_is_read_and_written(tmp_path: Path) -> None:
    made = read_superposition(_written(tmp_path, HEADER + ROWS), "load on tibia")
    assert (made.n, made.n_values) == (2, 5)
    np.testing.assert_array_equal(made.values[0, :4], [-10.0, 100.0, 5.0, np.nan])
    assert made.after == ("cut: ACL", "cut: ACL, MCL")
    again = read_superposition(write_superposition(made, tmp_path / "again.csv"))
    np.testing.assert_array_equal(again.values, made.values)
    np.testing.assert_array_equal(again.sd, made.sd)
    assert again.before == made.before
    sizes = HEADER.splitlines()[0].replace("force_x_N", "ACL_insitu_N") + ",pose_sd_mm\n"
    row = "a,ACL,intact,cut: ACL,120,,,4,,,0.1\n"
    text = sizes.replace("force_y", "LCL_insitu").replace("force_z", "MCL_insitu") + row
    size = read_superposition(_written(tmp_path, text))
    assert size.values[0, -1] == 120.0
    assert size.pose_sd.tolist() == [[0.1, 0.0]]
    again = read_superposition(write_superposition(size, tmp_path / "again.csv"))
    np.testing.assert_array_equal(again.values, size.values)


def test_a_cell_that_reads_the_reaction_has_the_other_sign(tmp_path: Path) -> None:
    path = _written(tmp_path, "# reads: reaction\n" + HEADER + ROWS)
    made = read_superposition(path)
    np.testing.assert_array_equal(made.values[0, :3], [10.0, -100.0, -5.0])


def test_consecutive_cuts_share_a_reading(tmp_path: Path) -> None:
    made = read_superposition(_written(tmp_path, HEADER + ROWS), "load on tibia")
    np.testing.assert_array_equal(made.shares(), [[1.0, -0.5], [-0.5, 1.0]])
    apart = replace(made, trials=("a", "b"))
    np.testing.assert_array_equal(apart.shares(), np.eye(2))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("cut: ACL,-10", "cut: PCL,-10", "does not follow"),
        ("ACL,intact", "ACL,cut: ACL", "cut already"),
        (",4,4,4", ",4,,4", "standard deviation"),
        ("a,ACL,", "a,,", "blank"),
        ("a,ACL,", "a,ACL,", "does not say whether the cell reads"),
        ('a,MCL,cut: ACL,"cut: ACL, MCL"', "a,ACL,intact,cut: ACL", "follows from rows above"),
    ],
)
def test_what_a_table_cannot_say(old: str, new: str, named: str, tmp_path: Path) -> None:
    path = _written(tmp_path, HEADER + ROWS.replace(old, new))
    reads = "" if named.startswith("does not say") else "load on tibia"
    with pytest.raises(ValueError, match=named):
        read_superposition(path, reads)


def test_a_sign_is_stated_once_and_is_one_of_two(tmp_path: Path) -> None:
    path = _written(tmp_path, "# reads: reaction\n" + HEADER + ROWS)
    with pytest.raises(ik.InputError, match="one place"):
        read_superposition(path, "load on tibia")
    path = _written(tmp_path, HEADER + ROWS)
    with pytest.raises(ValueError, match="reaction"):
        read_superposition(path, "reactions")


def test_an_experiments_file_has_one(tmp_path: Path) -> None:
    _written(tmp_path, HEADER + ROWS)
    (tmp_path / "tests.csv").write_text(TABLE)
    path = tmp_path / "experiments.toml"
    path.write_text(TOML)
    laxity = read_experiments(path)
    assert laxity.superposition is not None
    assert laxity.superposition.trials == ("a", "a")
    assert laxity.n_values == 2 + 5
    assert laxity.select([1]).superposition is None
    left = laxity.without(np.array([False, True])).superposition
    assert left is not None
    assert left.n == 2


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        (
            "superposition =",
            "table = 'tests.csv'\nsuperposition =",
            "has either a table or a superposition",
        ),
        ('superposition = "insitu.csv"', "", "has either a table or a superposition"),
        ("reads =", "state = 'cut: ACL'\nreads =", "states of its rows"),
        ("reads =", "rig = 'other'\nreads =", "made in the rig rig"),
        ('reads = "load on tibia"', "", "does not say whether"),
        ('table = "tests.csv"', 'superposition = "insitu.csv"', "paths that were replayed"),
        ('reads = "load on tibia"', "reads = 'up'", "up"),
    ],
)
def test_wrong_experiments_are_refused(old: str, new: str, named: str, tmp_path: Path) -> None:
    _written(tmp_path, HEADER + ROWS)
    (tmp_path / "tests.csv").write_text(TABLE)
    path = tmp_path / "experiments.toml"
    path.write_text(TOML.replace(old, new))
    with pytest.raises(ik.InputError, match=named):
        read_experiments(path)


def test_a_path_is_that_of_a_trial_made_before(tmp_path: Path) -> None:
    _written(tmp_path, HEADER + ROWS.replace("a,ACL", "c,ACL"))
    (tmp_path / "tests.csv").write_text(TABLE)
    path = tmp_path / "experiments.toml"
    path.write_text(TOML)
    with pytest.raises(ik.InputError, match="no table") as caught:
        read_experiments(path)
    assert caught.value.why.startswith("ACL in c:")
    (tmp_path / "tests.csv").write_text(TABLE.replace("0.5,\nb", "0.5,cut: MCL\nb"))
    _written(tmp_path, HEADER + ROWS)
    with pytest.raises(ik.InputError, match=r"'cut: MCL'.*'intact'"):
        read_experiments(path)


def test_of_two_trials_of_one_name_the_one_in_the_state_before_is_meant(tmp_path: Path) -> None:
    (tmp_path / "tests.csv").write_text(TABLE)
    (tmp_path / "cut.csv").write_text(TABLE)
    _written(tmp_path, HEADER + ROWS)
    path = tmp_path / "experiments.toml"
    cut = '[[experiments]]\nname = "cut"\ntable = "cut.csv"\nstate = "cut: ACL"\n'
    path.write_text(TOML + cut)
    made = read_experiments(path).superposition
    assert made is not None
    assert made.trials == ("tests/a", "cut/a")
    # The path of the intact knee, replayed again: named with its experiment.
    _written(tmp_path, HEADER + ROWS.replace("a,MCL", "tests/a,MCL"))
    made = read_experiments(path).superposition
    assert made is not None
    assert made.trials == ("tests/a", "tests/a")


def test_joined_tables_keep_their_paths() -> None:
    protocol = ik.load_protocol("drawer").select([0, 1])
    values = np.full((1, 7), np.nan)
    values[0, 0] = 1.0
    made = Superposition(
        trials=protocol.trials[1:2], cut=("ACL",), before=("intact",), after=("cut: ACL",),
        values=values, sd=np.ones((1, 7)), pose_sd=np.zeros((1, 2)),
    )  # fmt: skip
    laxity = ik.Laxity(protocol=protocol, coordinates=np.zeros((2, 5)), superposition=made)
    pairs = [
        (Experiment(name=x, rig="rig", mounting="rig-1"), laxity if x == "b" else
         replace(laxity, superposition=None))
        for x in "ab"
    ]  # fmt: skip
    whole = joined(pairs).superposition
    assert whole is not None
    assert whole.trials == (f"b/{protocol.trials[1]}",)


def test_a_laxity_is_written_with_its_in_situ_forces(tmp_path: Path) -> None:
    """They were left out without a word."""
    (tmp_path / "tests.csv").write_text(TABLE)
    row = "a,ACL,intact,cut: ACL,-10,100,5,4,4,4\n"
    _written(tmp_path, HEADER + row)
    (tmp_path / "experiments.toml").write_text(TOML)
    whole = read_experiments(tmp_path / "experiments.toml")
    path = ik.write_laxity(whole, tmp_path / "again.csv")
    assert whole.superposition is not None
    again = read_superposition(path.with_name("again_insitu.csv"))
    np.testing.assert_array_equal(again.values, whole.superposition.values)
    np.testing.assert_array_equal(again.sd, whole.superposition.sd)
    assert again.trials == whole.superposition.trials
