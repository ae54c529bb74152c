"""Experiments that contradict themselves or their knee are refused in one sentence, exit 2."""

from pathlib import Path

import pytest
from cli_runs import run

import identknee as ik
from identknee.laxity.experiment_tables import read_experiments
from identknee.model.experiments import check_states
from identknee.runs.errors import InputError

TWO = (
    '[[experiments]]\nname = "x"\ntable = "a.csv"\nrig = "r"\n'
    '[[experiments]]\nname = "y"\ntable = "b.csv"\nrig = "r"\n'
)
HEAD = "trial,flexion_deg,anterior_force_N,anterior_drawer_mm,sd_anterior_drawer_mm"
ROW = "drawer,30,100,4,0.3"
INSITU = (
    "trial,cut,before,after,force_x_N,force_y_N,force_z_N,sd_force_x_N,sd_force_y_N,sd_force_z_N"
)


def table(path: Path, columns: str = "", cells: str = "", trial: str = "drawer") -> None:
    path.write_text(f"{HEAD}{columns}\n{ROW.replace('drawer', trial)}{cells}\n", encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    table(tmp_path / "a.csv")
    table(tmp_path / "b.csv", ",state", ",cut: ACL", "other")
    table(tmp_path / "no_ligament.csv", ",state", ",cut: XYZ")
    table(tmp_path / "everything.csv", ",state", ',"cut: ACL, PCL, LCL, MCL"')
    table(tmp_path / "force.csv", ",state,ACL_tension_N,sd_ACL_tension_N", ",cut: ACL,50,5")
    insitu = f"{INSITU}\ndrawer,ACL,intact,cut: ACL,-119,166,66,5,5,5\n"
    (tmp_path / "insitu.csv").write_text(insitu, encoding="utf-8")
    files = {
        "one_rig_twice": TWO + '[rigs.r]\nnoise = "1mm,1deg"\n[rigs.r]\nnoise = "2mm,1deg"\n',
        "one_name_twice": TWO.replace('"y"', '"x"'),
        "unused_rig": TWO + '[rigs.other]\nnoise = "1mm,1deg"\n',
        "two_states": '[[experiments]]\nname = "y"\ntable = "b.csv"\nstate = "cut: MCL"\n',
        "two_sides": TWO.replace('"x"', '"x"\nside = "left"').replace('"y"', '"y"\nside = "right"'),
        "other_side": TWO.replace('"x"', '"x"\nside = "left"'),
        "no_side": TWO.replace('"x"', '"x"\nside = "medial"'),
        "unknown_key": TWO + "mounted = true\n",
        "number_as_state": TWO.replace('"x"', '"x"\nstate = 1'),
        "rig_in_words": TWO + "[rigs.r]\nnoise = 1\n",
        "unsigned_wrench": TWO + '[[experiments]]\nname = "i"\nsuperposition = "insitu.csv"\n'
        'rig = "r"\n',
    }
    for name, text in files.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    return tmp_path


CASES = {
    "no_ligament.csv": "cuts XYZ, and reference has no such ligament; name one of",
    "everything.csv": "cuts every ligament of reference; leave out its trials",
    "force.csv": "the force of ACL in drawer, where it is cut; leave that cell blank",
    "one_rig_twice.toml": "twice",
    "one_name_twice.toml": "two experiments are called x. Give each its own name",
    "unused_rig.toml": "no experiment was made with this rig. Rigs of the experiments: r",
    "two_states.toml": "'cut: MCL', and its table says 'cut: ACL'. State it in one place",
    "two_sides.toml": "x is of a left knee, and y of a right one. Fit the two sides each alone",
    "other_side.toml": "x is of a left knee, and reference is a right one; give the tables of one",
    "no_side.toml": "the side 'medial' is unknown. Write left or right",
    "unknown_key.toml": ", [[experiments]] block 2, mounted: this word is unknown here",
    "number_as_state.toml": ", [[experiments]] block 1, state: 1 is not text",
    "rig_in_words.toml": ", [rigs.r], noise: 1 is not text",
    "unsigned_wrench.toml": "does not say whether the cell reads the load on the tibia",
}


@pytest.mark.parametrize("name", CASES)
def test_one_sentence_and_exit_2(name: str, folder: Path) -> None:
    result = run("fit", "reference", folder / name, "--more-starts", 0)
    assert result.exit_code == 2
    said = [x for x in result.stderr.splitlines() if x]
    assert len(said) == 1
    assert said[0].startswith("identknee: ")
    assert CASES[name] in said[0]


def test_a_noise_that_cannot_be_read_is_found_in_the_file(folder: Path) -> None:
    text = "trial,flexion_deg,anterior_force_N,anterior_drawer_mm\ndrawer,30,100,4\n"
    (folder / "a.csv").write_text(text, encoding="utf-8")
    rig = '[[experiments]]\nname = "x"\ntable = "a.csv"\nrig = "r"\n[rigs.r]\nnoise = "1mm"\n'
    (folder / "noise.toml").write_text(rig, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_experiments(folder / "noise.toml")
    assert (Path(caught.value.path).name, caught.value.where) == ("noise.toml", "[rigs.r]")


def test_a_side_that_agrees_is_kept(folder: Path) -> None:
    (folder / "right.toml").write_text(TWO.replace('"x"', '"x"\nside = "right"'), encoding="utf-8")
    laxity = read_experiments(folder / "right.toml")
    assert [x.side for x in laxity.protocol.experiments] == ["right", ""]
    check_states(ik.example("reference"), laxity.protocol)
