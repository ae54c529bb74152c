from pathlib import Path

import numpy as np
import pytest

from identknee.laxity.protocol import BUILT_IN, LOADS, Protocol, concatenate, load_protocol
from identknee.runs.errors import InputError

INTERNAL, VARUS, ANTERIOR = (LOADS.index(x) for x in LOADS[:3])


def protocol(*trials: str, flexion: float = 30.0, load: float = 5.0) -> Protocol:
    n = len(trials)
    loads = np.zeros((n, 5))
    loads[:, VARUS] = load
    return Protocol(name="mine", trials=trials, flexion_deg=np.full(n, flexion), loads=loads)


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_seed63_is_the_protocol_of_the_paper() -> None:
    seed63 = load_protocol("seed63")
    assert (seed63.name, seed63.n, seed63.is_unloaded.sum()) == ("seed63", 63, 3)
    rows = {(f, *row) for f, row in zip(seed63.flexion_deg, seed63.loads.tolist(), strict=True)}
    expected = set()
    for flexion in (0.0, 30.0, 60.0):
        for moment in range(-10, 11, 2):
            expected.add((flexion, float(moment), 0.0, 0.0, 0.0, 0.0))
            expected.add((flexion, 0.0, float(moment), 0.0, 0.0, 0.0))
    assert {tuple(map(float, row)) for row in rows} == expected
    assert "flexion30_varus-4Nm" in seed63.trials
    assert "flexion0_unloaded" in seed63.trials


def test_drawer_pushes_both_ways_at_three_angles() -> None:
    drawer = load_protocol("drawer")
    assert drawer.n == 9
    assert sorted(set(drawer.loads[:, ANTERIOR])) == [-100, 0, 134]
    assert not drawer.loads[:, [0, 1, 3, 4]].any()
    assert drawer.is_unloaded.sum() == 3


def test_table2_has_thirteen_loads_and_four_unloaded_angles() -> None:
    table2 = load_protocol("table2")
    assert table2.n == 17
    assert sorted(table2.flexion_deg[table2.is_unloaded]) == [0, 20, 30, 60]


def test_every_built_in_protocol_is_listed() -> None:
    folder = Path(load_protocol.__code__.co_filename).parent / "protocols"
    assert sorted(path.stem for path in folder.glob("*.toml")) == sorted(BUILT_IN)


def test_a_users_protocol_combines_loads(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        format = 1
        description = "with compression"
        [[ramps]]
        flexion_deg = 45
        load = "varus_moment_Nm"
        values = [-2.5, 0]
        held = { distraction_force_N = -200 }
        [[trials]]
        flexion_deg = 12.5
        internal_moment_Nm = 4
        anterior_force_N = -30
        [[trials]]
        name = "again"
        flexion_deg = 12.5
        internal_moment_Nm = 4
        anterior_force_N = -30
        """,
    )
    mine = load_protocol(path)
    assert mine.name == "mine"
    assert mine.trials == (
        "flexion45_varus-2.5Nm_distraction-200N",
        "flexion45_distraction-200N",
        "flexion12.5_internal4Nm_anterior-30N",
        "again",
    )
    assert mine.loads[:, ANTERIOR].tolist() == [0, 0, -30, -30]
    assert mine.loads[:, INTERNAL].tolist() == [0, 0, 4, 4]
    assert not mine.is_unloaded.any()


RAMP = '[[ramps]]\nflexion_deg = [0]\nload = "varus_moment_Nm"\nvalues = [1]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# x", "format: the format is not given. Write format = 1, the only one there is."),
        ("format = 2", "format: the format is 2. Write format = 1, the only one there is."),
        ("format = 1", "there is no trial. Add a [[ramps]] or [[trials]] block."),
        ("format = 1\nramp = 3", "the word 'ramp' is unknown here. Did you mean ramps?"),
        (
            "format = 1\nramps = 3",
            "ramps: a list of blocks is wanted. Start each with a line [[ramps]].",
        ),
        (
            "format = 1\n[[ramps]]\nload = 'varus'",
            "[[ramps]] block 1, load: there is no load 'varus'. Did you mean varus_moment_Nm?",
        ),
        (
            "format = 1\n[[ramps]]\nload = 'varus_moment_Nm'\nvalues = [1]",
            (
                "[[ramps]] block 1, flexion_deg: it is missing. "
                "Write flexion_deg = [0, 30] or other numbers."
            ),
        ),
        (
            "format = 1\n" + RAMP + RAMP.replace("[1]", "[1, '2']"),
            "[[ramps]] block 2, values: '2' is not a number. Write numbers without quotes.",
        ),
        (
            "format = 1\n" + RAMP.replace("[1]", "[10000]"),
            (
                "[[ramps]] block 1, values: a moment of 10000 N·m is beyond 50 N·m either way. "
                "Divide it by 1000 if it is in N·mm, by 100 if in N·cm, by 8.85 if in inch-pounds."
            ),
        ),
        (
            "format = 1\n" + RAMP.replace("[0]", "[200]"),
            (
                "[[ramps]] block 1, flexion_deg: a flexion of 200 deg lies outside -10 to 160 deg. "
                "Give the flexion angle in degrees, 0 in extension."
            ),
        ),
        (
            "format = 1\n" + RAMP.replace("[1]", "[nan]"),
            "[[ramps]] block 1, values: nan is not a finite number. Give one.",
        ),
        (
            "format = 1\n[[trials]]\nflexion_deg = 0\nanterior_force_N = 1200",
            (
                "[[trials]] block 1, anterior_force_N: a force of 1200 N is beyond 1000 N "
                "either way. Check its unit: forces are given in N."
            ),
        ),
        (
            "format = 1\n[[trials]]\nflexion_deg = 0\n[[trials]]\nflexion_deg = 0",
            (
                "[[trials]] block 2: the trial 'flexion0_unloaded' is there already. "
                "Give it another name."
            ),
        ),
        (
            "format = 1\n[[trials]]\nflexion_deg = [0, 30]",
            (
                "[[trials]] block 1, flexion_deg: a trial has one angle, not 2. "
                "Write a block for each angle, or a [[ramps]] block."
            ),
        ),
        (
            "format = 1\n[[trials]]\nname = ' '\nflexion_deg = 0",
            "[[trials]] block 1, name: the trial has no name. Give every trial a name of its own.",
        ),
    ],
)
def test_messages_name_place_and_remedy(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_protocol(path)
    joint = ", " if caught.value.where else ": "
    assert str(caught.value) == f"{path}{joint}{message}"


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 5000,
        "a = 1" + "0" * 5000,
        "a = 2000-02-31",
        "format = 0x" + "f" * 5000,
        "format = [[[1]]]",
        "format = 1\nname = 3",
        "format = 1\nramps = [3]",
        "format = 1\n[[trials]]\nflexion_deg = 0x" + "f" * 5000,
        "format = 1\n[[ramps]]\nload = [1]",
        "format = 1\n" + RAMP.replace("[0]", str([30] * 1000)).replace("[1]", str([1] * 1000)),
    ],
)
def test_odd_files_end_in_a_sentence(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"mine\.toml.*: .*\. [A-Z]") as caught:
        load_protocol(written(tmp_path, text))
    assert len(str(caught.value)) < 400
    assert "\n" not in str(caught.value)


def test_text_that_is_not_toml(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"TOML: .*line 1"):
        load_protocol(written(tmp_path, "format : 1"))
    path = tmp_path / "mine.toml"
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match=r"UTF-8"):
        load_protocol(path)


def test_unknown_names_get_the_closest_one() -> None:
    with pytest.raises(InputError, match=r"seed36: .* seed63\?"):
        load_protocol("seed36")
    with pytest.raises(InputError, match=r"mine\.toml.*such"):
        load_protocol("nowhere/mine.toml")


def test_select_takes_numbers_and_masks() -> None:
    seed63 = load_protocol("seed63")
    some = seed63.select([62, 0])
    assert some.trials == (seed63.trials[62], seed63.trials[0])
    assert some.flexion_deg.tolist() == [60, 0]
    masked = seed63.select(seed63.is_unloaded)
    assert masked.n == 3
    assert not masked.loads.any()
    assert seed63.select([]).n == 0
    with pytest.raises(ValueError, match="trial 63"):
        seed63.select([63])
    with pytest.raises(ValueError, match="mask of 63"):
        seed63.select([True])
    with pytest.raises(ValueError, match=f"two trials.*{seed63.trials[1]}"):
        seed63.select([1, 1])


def test_concatenate_keeps_shared_trials_once() -> None:
    both = concatenate([load_protocol("seed63"), load_protocol("drawer")], name="both")
    assert both.n == 63 + 6
    assert both.name == "both"
    with pytest.raises(ValueError, match=r"trials.*'a'"):
        concatenate([protocol("a"), protocol("a", load=6)])


@pytest.mark.parametrize(
    ("flexion", "load", "words"),
    [
        (30, 10000, "trial 'a', varus_moment_Nm: a moment of 10000 N·m .* Divide it by 1000 if"),
        (170, 5, "outside -10 to 160 deg"),
        (30, np.nan, "nan is not a finite number"),
    ],
)
def test_protocol_checks_its_values(flexion: float, load: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        protocol("a", flexion=flexion, load=load)


@pytest.mark.parametrize("name", ["", " a", "a\nb"])
def test_protocol_checks_its_names(name: str) -> None:
    with pytest.raises(ValueError, match=r"a name|visible"):
        protocol(name)


def test_protocol_is_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        protocol("a").loads[0, 0] = 1
