"""Loading curves from time series: the truth of simulated ramps, files as labs write them."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from small_knee import small_knee

from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity, read_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.errors import InputError

PAGE = Path(__file__).parents[3] / "docs" / "measured_tables.md"
LARGEST, LOOP = 0.4, 1.5  # N m, and deg that loading and unloading are off the elastic curve
HEADER = ("time_s", "trial", "flexion_deg", LOADS[0], *COORDINATES)


def elastic(moments: Sequence[float]) -> Laxity:
    n = len(moments)
    loads = np.zeros((n, 5))
    loads[:, 0] = moments
    names = tuple(f"t{i}" for i in range(n))
    protocol = Protocol(name="ramp", trials=names, flexion_deg=np.full(n, 6.0), loads=loads)
    model = LaxityModel(knee=small_knee(), protocol=protocol)
    return model.simulate(model.parameters.start)


def loops(cycles: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Moments and coordinates of cycles of loading, a loop in internal rotation, noise in all."""
    up = np.linspace(-LARGEST, LARGEST, 41)
    exact = elastic(up.tolist()).coordinates
    off = np.array([0.0, 0.0, 0.0, 0.0, LOOP])
    moments = np.tile(np.r_[up[::-1], up], cycles)
    made = np.tile(np.vstack([exact[::-1] + off, exact - off]), (cycles, 1))
    return moments, made + 0.02 * np.random.default_rng(0).standard_normal(made.shape)


def written(path: Path, moments: np.ndarray, made: np.ndarray, head: str = "") -> Path:
    rows = [
        [str(0.1 * i), "turn", "6", repr(float(x)), *(repr(float(v)) for v in values)]
        for i, (x, values) in enumerate(zip(moments, made, strict=True))
    ]
    lines = [",".join(x) for x in (HEADER, *rows)]
    path.write_text(head + "\n".join(lines), encoding="utf-8")
    return path


def test_the_mean_of_loops_is_the_elastic_curve_and_their_spread_the_error(tmp_path: Path) -> None:
    path = written(tmp_path / "loops.csv", *loops(), head="# levels: 25 50 75\n")
    read = read_laxity(path)
    assert read.protocol.trials[:2] == ("turn_external0.1", "turn_external0.2")
    moments = read.protocol.loads[:, 0]
    np.testing.assert_allclose(moments, LARGEST * np.array([-0.25, -0.5, -0.75, 0.25, 0.5, 0.75]))
    expected = elastic(moments.tolist())
    np.testing.assert_allclose(read.coordinates, expected.coordinates, atol=0.03)
    assert read.sd is not None
    # Six crossings of each level: three on either side of the mean.
    np.testing.assert_allclose(read.sd[:, 4], LOOP * np.sqrt(6 / 5), rtol=0.03)
    np.testing.assert_allclose(read.sd[:, :4], 0.02, rtol=0.5)


def test_a_ramp_that_goes_one_way_states_no_error(tmp_path: Path) -> None:
    moments = np.linspace(0.0, 2 * LARGEST, 11)
    read = read_laxity(
        written(tmp_path / "ramp.csv", moments, elastic(moments.tolist()).coordinates)
    )
    assert read.sd is None
    assert read.protocol.trials == ("turn_internal0.4", "turn_internal0.8")
    np.testing.assert_allclose(read.coordinates, elastic([0.4, 0.8]).coordinates, atol=1e-6)


def test_the_page_shows_what_is_read(tmp_path: Path) -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Loading curves over time")[1]
    series, table = re.findall(r"```text\n(.*?)```", section.split("\n## ")[0], re.DOTALL)
    for name, text in (("series.csv", series), ("table.csv", table)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    read, expected = read_laxity(tmp_path / "series.csv"), read_laxity(tmp_path / "table.csv")
    assert read.protocol.trials == expected.protocol.trials
    np.testing.assert_allclose(read.protocol.loads, expected.protocol.loads)
    np.testing.assert_allclose(read.coordinates, expected.coordinates)
    assert read.sd is not None
    assert expected.sd is not None
    np.testing.assert_allclose(read.sd, expected.sd, atol=5e-4)


def test_an_opensim_storage_is_read_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "ramp.sto"
    path.write_text(
        "rig\nversion=1\nnRows=3\ninDegrees=no\n"
        "# column: flexion_deg = knee_flex\n# column: internal_deg = - knee_rot\n"
        "# column: anterior_drawer_mm = 1000 * knee_tx\n# column: internal_moment_Nm = Mz\n"
        "endheader\n"
        "time\tknee_flex\tknee_rot\tknee_tx\tMz\thip_flex\n"
        "0\t0.5\t0.0\t0.001\t0\t0.3\n1\t0.5\t-0.1\t0.002\t4\t0.3\n2\t0.5\t-0.2\tnan\t8\t0.3\n",
        encoding="utf-8",
    )
    read = read_laxity(path)
    assert read.protocol.trials == ("ramp_internal4", "ramp_internal8")
    np.testing.assert_allclose(read.protocol.flexion_deg, np.degrees(0.5))
    np.testing.assert_allclose(read.coordinates[:, 4], np.degrees([0.1, 0.2]))
    np.testing.assert_allclose(read.coordinates[:, 1], 2.0)
    assert "version=1" in read.comments


def test_columns_of_any_table_may_have_other_names(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(
        "# column: internal_deg = -57.3 * Rot\n# column: valgus_moment_Nm = Mvv\n"
        "trial,flexion_deg,Mvv,Rot\na,30,5,0.1\n",
        encoding="utf-8",
    )
    read = read_laxity(path)
    np.testing.assert_allclose(read.coordinates[0, 4], -5.73)
    np.testing.assert_allclose(read.protocol.loads[0], [0, -5, 0, 0, 0])
    assert read.comments == ()


@pytest.mark.parametrize(
    ("head", "column", "values", "sentence"),
    [
        ("", 0, [0, 2, 1], "ramp turn: time goes back"),
        ("", 2, [0, 20, 40], "flexion changes by 40.0 deg"),
        ("", 3, [0, 0.1, 0.2], "no load changes by more than 10 %"),
        ("# levels: 0, 50\n", 3, [0, 2, 4], "'0, 50' are not levels of a load"),
        ("# column: internal_deg is r\n", 3, [0, 2, 4], "row 1: 'column: internal_deg is r' does"),
        ("# column: varus_deg = r\n", 3, [0, 2, 4], "row 1: there is no column r"),
        ("# column: varus_deg = internal_deg\n", 3, [0, 2, 4], "varus_deg is there already"),
    ],
)
def test_what_cannot_be_read_is_said(
    tmp_path: Path, head: str, column: int, values: Sequence[float], sentence: str
) -> None:
    path = written(tmp_path / "x.csv", np.array([0.0, 2.0, 4.0]), np.zeros((3, 5)))
    lines = [line.split(",") for line in path.read_text(encoding="utf-8").split("\n")]
    for line, value in zip(lines[1:], values, strict=True):
        line[column] = str(value)
    path.write_text(head + "\n".join(",".join(x) for x in lines), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(sentence)):
        read_laxity(path)


def test_two_loads_at_once_are_no_curve(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(
        "time_s,flexion_deg,internal_moment_Nm,anterior_force_N,varus_deg\n"
        "0,30,0,0,0\n1,30,5,100,1\n",
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=r"ramp x: .*\(100\).*\(5\)"):
        read_laxity(path)
