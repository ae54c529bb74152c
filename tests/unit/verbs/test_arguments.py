"""What notebooks give to verbs: data frames, single names, one number of noise, values to start at.

Each stands for what it would be written as: answers and messages are those of the file.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import identknee as ik
from identknee.laxity.table import COORDINATES, read_trials
from identknee.runs.errors import InputError
from identknee.runs.files import digest
from identknee.verbs.options import parameters_in_full
from identknee.verbs.values import noise_of, noise_words
from identknee.verbs.verb import read_arguments

NOISE = (0.5, 0.25)
NAME = "ACL.stiffness_kN"


@pytest.fixture(scope="module")
def measured() -> ik.Laxity:
    """Four trials with a blank, names that a comment could be taken for, and a stated noise."""
    protocol = ik.load_protocol("drawer").select([0, 1, 3, 4])
    protocol = ik.Protocol(
        name="kept",
        trials=("#1", 'a "b", c', "x;y", "7"),
        flexion_deg=protocol.flexion_deg,
        loads=protocol.loads,
    )
    simulated = ik.simulate(ik.reference_knee(), protocol).laxity
    coordinates = np.array(simulated.coordinates)
    coordinates[2, 1] = np.nan
    sd = np.full(coordinates.shape, NOISE[0])
    sd[:, 3:] = NOISE[1]
    return ik.Laxity(protocol=protocol, coordinates=coordinates, sd=sd)


@pytest.fixture(scope="module")
def path(measured: ik.Laxity, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ik.write_laxity(measured, tmp_path_factory.mktemp("table") / "few.csv")


@pytest.fixture(scope="module")
def frame(path: Path) -> pd.DataFrame:
    return pd.read_csv(path)


def test_a_frame_of_a_file_whose_first_line_is_a_comment(path: Path, measured: ik.Laxity) -> None:
    commented = path.with_name("commented.csv")
    commented.write_text(f"# of one knee\n{path.read_text(encoding='utf-8')}", encoding="utf-8")
    same(ik.read_laxity(pd.read_csv(commented)), measured)


def same(read: ik.Laxity, expected: ik.Laxity) -> None:
    assert read.protocol.trials == expected.protocol.trials
    np.testing.assert_array_equal(read.protocol.flexion_deg, expected.protocol.flexion_deg)
    np.testing.assert_array_equal(read.protocol.loads, expected.protocol.loads)
    np.testing.assert_array_equal(read.coordinates, expected.coordinates)
    np.testing.assert_array_equal(read.sd, expected.sd)
    assert read.zero == expected.zero
    assert read.within_trial_correlation == expected.within_trial_correlation


FRAMES: list[Callable[[pd.DataFrame], pd.DataFrame]] = [
    lambda x: x,
    lambda x: x.set_index("trial"),
    lambda x: x.sample(frac=1, random_state=0).sort_index(),
    lambda x: x.convert_dtypes(),
    lambda x: x.astype(object).where(x.notna(), None),
]


@pytest.mark.parametrize("made", FRAMES)
def test_a_frame_is_the_table_that_it_would_be_saved_as(
    made: Callable[[pd.DataFrame], pd.DataFrame], frame: pd.DataFrame, measured: ik.Laxity
) -> None:
    same(ik.read_laxity(made(frame)), measured)


def test_attrs_of_a_frame_state_what_comment_lines_do(frame: pd.DataFrame) -> None:
    stated = frame.copy()
    stated.loc[stated["anterior_force_N"] == 0, list(COORDINATES)] = np.nan
    stated.attrs = {"zero": "unloaded", "within_trial_correlation": 0.25, "author": "anyone"}
    read = ik.read_laxity(stated)
    assert (read.zero, read.within_trial_correlation, read.comments) == ("unloaded", 0.25, ())
    stated.attrs["zero"] = "nowhere"
    with pytest.raises(InputError, match=r"DataFrame, attrs 'zero'"):
        ik.read_laxity(stated)


def test_an_attr_that_is_misspelled_is_named(frame: pd.DataFrame) -> None:
    named = frame.copy()
    named.attrs = {"translation": "projections"}
    with pytest.raises(InputError, match=r"attrs 'translation': .*# translations: projections"):
        ik.read_laxity(named)


@pytest.mark.parametrize(
    ("changed", "where"),
    [
        (lambda x: x.rename(columns={"varus_deg": "varus_rad"}), "columns, column varus_rad"),
        (lambda x: x.assign(varus_deg="much"), "row 0, column varus_deg"),
        (lambda x: x.set_index(pd.Index([9, 8, 7, 6])).assign(trial="a"), "row 8, column trial"),
        (lambda x: x.drop(columns="flexion_deg"), "columns, column flexion_deg"),
        (lambda x: x.assign(varus_deg=[1.0, np.inf, 2.0, 3.0]), "row 1, column varus_deg"),
        (lambda x: pd.concat({"robot": x}, axis=1), "columns"),
        (lambda x: x.iloc[:0], ""),
    ],
)
def test_mistakes_of_a_frame_are_named_by_its_own_rows_and_columns(
    changed: Callable[[pd.DataFrame], pd.DataFrame], where: str, frame: pd.DataFrame
) -> None:
    with pytest.raises(InputError) as caught:
        ik.read_laxity(changed(frame))
    assert (caught.value.path, caught.value.where) == ("DataFrame", where)


def test_a_frame_stands_wherever_trials_are_planned(
    frame: pd.DataFrame, measured: ik.Laxity
) -> None:
    planned = frame[["trial", "flexion_deg", "anterior_force_N"]]
    for given in (planned, measured, frame):
        assert read_trials(given).trials == measured.protocol.trials
    knee = ik.reference_knee()
    expected = ik.simulate(knee, measured.protocol).laxity.coordinates
    np.testing.assert_array_equal(ik.simulate(knee, planned).laxity.coordinates, expected)


def test_answers_to_a_frame_are_those_to_its_file(
    frame: pd.DataFrame, path: Path, tmp_path: Path
) -> None:
    of_file = ik.information("reference", path)
    of_frame = ik.information("reference", frame, out=tmp_path)
    assert of_frame.question is not None
    assert of_file.question is not None
    assert of_frame.question.differences(of_file.question) == ()
    np.testing.assert_array_equal(of_frame.fisher.jacobian, of_file.fisher.jacobian)
    loaded = ik.load(tmp_path)
    assert loaded.record is not None
    assert loaded.record.settings["data"] == "a table in memory"
    assert loaded.record.inputs["data"] != digest(path)


@pytest.mark.parametrize(
    ("verb", "option", "given", "expected"),
    [
        (ik.profile, "parameters", NAME, (NAME,)),
        (ik.fit, "fixed", NAME, (NAME,)),
        (ik.information, "keep", "a*", ("a*",)),
        (ik.sample, "leave_out", "a*", ("a*",)),
        (ik.fit, "fixed", np.array([NAME]), [NAME]),
        (ik.fit, "fixed", pd.Index([NAME]), [NAME]),
        (ik.fit, "fixed", [NAME], [NAME]),
        (ik.fit, "fixed", None, None),
        (ik.fit, "start", "IG2", "IG2"),
        (ik.fit, "uncertain", "insertions=2mm", "insertions=2mm"),
        (ik.fit, "bounds", f"{NAME}=5:15", (f"{NAME}=5:15",)),
        (ik.simulate, "values", f"{NAME}=5", (f"{NAME}=5",)),
        (ik.fit, "noise", 0.3, "0.3mm,0.3deg"),
        (ik.fit, "noise", np.float32(0.5), "0.5mm,0.5deg"),
        (ik.fit, "noise", 1, "1.0mm,1.0deg"),
        (ik.isolability, "noise", NOISE, "0.5mm,0.25deg"),
        (ik.fit, "noise", np.array(NOISE), "0.5mm,0.25deg"),
        (ik.fit, "noise", None, None),
        (ik.fit, "noise", {"mm": 0.5, "deg": 0.25}, "0.5mm,0.25deg"),
        (ik.fit, "start", {NAME: 9.5}, {NAME: 9.5}),
        (ik.profile, "start", pd.Series({NAME: 9.5}), {NAME: 9.5}),
        (ik.diagnose, "start", "IG2", "IG2"),
        (ik.fit, "start", {NAME: np.float32(9.5)}, {NAME: 9.5}),
        (ik.fit, "start", {"ACL": {"stiffness_kN": np.int64(9)}}, {"ACL": {"stiffness_kN": 9}}),
        (ik.fit, "uncertain", {"insertions_mm": np.float32(2.0)}, {"insertions_mm": 2.0}),
        (ik.fit, "bounds", pd.Series({NAME: (5, 20)}), {NAME: (5, 20)}),
        (ik.simulate, "values", pd.Series({NAME: 9.5}), {NAME: 9.5}),
        (ik.profile, "parameters", pd.Series([NAME]), [NAME]),
    ],
)
def test_one_name_is_a_list_of_one_and_one_number_both_sizes_of_noise(
    verb: Callable[..., Any], option: str, given: Any, expected: Any
) -> None:
    arguments = {"subject": "reference", option: given}
    assert read_arguments(parameters_in_full(verb), arguments)[option] == expected


@pytest.mark.parametrize(
    "noise",
    [True, (0.3,), (0.3, 0.3, 0.3), -1.0, 0.0, float("nan"), {}, {"mm": 0.3}, {"a": 1, "b": 2}],
)
def test_what_is_no_size_of_noise_is_refused(noise: Any) -> None:
    with pytest.raises(ValueError, match="noise"):
        noise_words(noise)


def test_one_number_of_noise_stands_for_lengths_and_angles(frame: pd.DataFrame) -> None:
    asked = ik.information("reference", frame, noise=0.3).question
    assert asked is not None
    assert (asked.noise_mm, asked.noise_deg) == (0.3, 0.3) == noise_of(0.3)


def test_a_fit_starts_at_values_by_parameter_or_by_ligament(frame: pd.DataFrame) -> None:
    knee = ik.reference_knee()
    own = {x.name: x.stiffness_kN for x in knee.ligaments}
    for start in ({NAME: 9.5}, {"ACL": {"stiffness_kN": 9.5}}):
        answer = ik.fit(knee, frame, start=start, budget=1)
        begun = answer.start_parameters
        assert begun["ACL"]["stiffness_kN"] == 9.5
        assert begun["MCL"]["stiffness_kN"] == own["MCL"]
    assert ik.fit(knee, frame, start=answer.parameter_set, budget=1).objective <= answer.objective
    begin: Any = answer
    again = ik.fit(knee, frame, start=begin, budget=1)
    assert again.start_parameters == answer.parameters


def test_a_fit_starts_where_one_with_stated_errors_ended(frame: pd.DataFrame) -> None:
    """Its errors are none of the parameters of a knee whose errors are not stated."""
    uncertain = ik.fit("reference", frame, uncertain="registration=1deg", budget=2, more_starts=0)
    assert uncertain.nuisances
    begin: Any = uncertain
    again = ik.fit("reference", frame, start=begin, budget=1)
    for name, own in again.start_parameters.items():
        assert own == uncertain.parameters[name]


@pytest.mark.parametrize("start", [np.ones(8), [9.5, 8.0], 9.5, ik.reference_knee])
def test_what_is_no_start_is_refused_with_what_is(start: Any, frame: pd.DataFrame) -> None:
    with pytest.raises(ValueError, match=r"is no start; .*'ACL.stiffness_kN'"):
        ik.fit("reference", frame, start=start)


def test_data_frames_side_by_side_are_told_apart(frame: pd.DataFrame) -> None:
    asked = {"subject": "reference", "data": [frame, frame.copy(), "few.csv"]}
    tables = read_arguments(parameters_in_full(ik.fit), asked)["data"]
    assert [x.protocol.name for x in tables[:2]] == ["DataFrame1", "DataFrame2"]
    assert tables[2] == "few.csv"


@pytest.mark.parametrize("protocol", ["drawer", "seed63", ik.load_protocol("table2")])
def test_a_protocol_where_the_subject_belongs_is_named(protocol: Any) -> None:
    exchanged: list[Any] = ["reference", ik.reference_knee()]
    for knee in exchanged:
        with pytest.raises(ValueError, match="changed places"):
            ik.simulate(protocol, knee)
    with pytest.raises(ValueError, match="subject belongs"):
        ik.simulate(protocol)


@pytest.mark.parametrize(
    ("start", "where"),
    [
        ({"ACL.stiffnes_kN": 9.5}, "ACL.stiffnes_kN"),
        ({NAME: "much"}, NAME),
        ({NAME: 900.0}, NAME),
        ({"ACL": {"k": 1.0}}, "ACL.k"),
    ],
)
def test_values_to_start_at_are_checked_as_a_file_of_them(
    start: dict[str, Any], where: str, frame: pd.DataFrame
) -> None:
    with pytest.raises(InputError) as caught:
        ik.fit("reference", frame, start=start)
    assert caught.value.where == where


@pytest.mark.parametrize("call", [ik.fit, ik.information, ik.profile, ik.sweep, ik.diagnose])
def test_exchanged_arguments_are_named(call: Callable[..., Any], frame: pd.DataFrame) -> None:
    for table in (frame, ik.read_laxity(frame), "few.csv", Path("a.sto")):
        for knee in (ik.reference_knee(), "reference", "knee.osim"):
            with pytest.raises(ValueError, match="changed places"):
                call(table, knee)


@pytest.mark.parametrize(
    ("subject", "data"),
    [
        ("few.csv", "few.csv"),
        ([1], "few.csv"),
        (None, "few.csv"),
        ("reference", [1]),
        ("reference", ik.reference_knee),
        ("reference", "reference"),
        ("reference", 3.0),
    ],
)
def test_what_is_no_subject_or_no_table_is_refused_with_a_remedy(subject: Any, data: Any) -> None:
    with pytest.raises(ValueError, match=r"belongs|is no subject|is not a laxity table"):
        ik.fit(subject, data)


def test_every_coordinate_of_a_frame_is_read(frame: pd.DataFrame, measured: ik.Laxity) -> None:
    for k, name in enumerate(COORDINATES):
        alone = ik.read_laxity(frame[["trial", "flexion_deg", name]]).coordinates
        np.testing.assert_array_equal(alone[:, k], measured.coordinates[:, k])


@pytest.mark.parametrize("kind", ["dict", "records", "series", "rows", "array", "bytes", "none"])
def test_what_is_like_a_table_is_refused_by_reading_too(kind: str, frame: pd.DataFrame) -> None:
    made: dict[str, Any] = {
        "dict": frame.to_dict("list"),
        "records": frame.to_dict("records"),
        "series": frame[COORDINATES[0]],
        "rows": frame.to_records(index=False),
        "array": frame.drop(columns="trial").to_numpy(),
        "bytes": b"trial,flexion_deg",
        "none": None,
    }
    with pytest.raises(ValueError, match=r"is not a laxity table; give a path, .* DataFrame"):
        ik.read_laxity(made[kind])


def test_the_text_of_a_table_is_no_path(path: Path) -> None:
    with pytest.raises(InputError, match=r"^trial.{0,45}: this is a text of 5 lines, not the path"):
        ik.read_laxity(path.read_text())


def test_an_index_of_names_without_a_name_is_named(frame: pd.DataFrame) -> None:
    own = frame.set_index("trial")
    assert ik.read_laxity(own).n == len(own)
    own.index.name = None
    with pytest.raises(InputError, match=r"no column trial. .*frame\.index\.name = \"trial\""):
        ik.read_laxity(own)


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        ({"fix": NAME}, r"fit has no argument fix\. Did you mean fixed\?"),
        ({"hold_outs": "x"}, r"no argument hold_outs\. Did you mean hold_out\?"),
        ({"bounds": {NAME: 5}}, r"bounds of ACL.stiffness_kN: 5 is no pair of numbers"),
        ({"bounds": {NAME: (5, None)}}, r"\(5, None\) is no pair of numbers"),
        ({"bounds": {NAME: (1, 2, 3)}}, r"\(1, 2, 3\) is no pair of numbers"),
        ({"more_starts": "3"}, r"more_starts is '3'; give a whole number of at least 0"),
        ({"more_starts": -3}, "more_starts is -3; give"),
        ({"more_starts": 2.5}, r"more_starts is 2\.5; give"),
        ({"seed": None}, "seed is None; give a whole number"),
        ({"budget": True}, "budget is True; give a whole number"),
        ({"fixed": {NAME: 12.0}}, r"fixed is values by name, .* as start=\{"),
        ({"fixed": pd.Series({NAME: 12.0})}, r"fixed has 12\.0, which is no name"),
        ({"fixed": (NAME, 12.0)}, r"fixed has 12\.0, which is no name"),
        ({"fixed": 1}, "fixed is 1, and takes names alone"),
        ({"fixed": f"{NAME}=12"}, r"--fix ACL.stiffness_kN=12: a parameter is held at its start"),
        ({"leave_out": {"a": True}}, "leave_out is values by name"),
        ({"uncertain": {"insertions": 2.0}}, r"no such part\. Did you mean insertions_mm\?"),
    ],
)
def test_mistakes_of_a_call_are_named(
    mistake: dict[str, Any], said: str, frame: pd.DataFrame
) -> None:
    with pytest.raises((ValueError, TypeError), match=said):
        ik.fit("reference", frame, **mistake)


def test_names_by_place_are_said_to_want_a_name(frame: pd.DataFrame) -> None:
    call: Any = ik.profile
    with pytest.raises(TypeError, match="takes subject and data by place alone"):
        call("reference", frame, NAME)


def test_whole_numbers_however_given(frame: pd.DataFrame) -> None:
    asked = {"subject": "reference", "data": frame, "more_starts": np.int64(3), "seed": 2.0}
    read = read_arguments(parameters_in_full(ik.fit), asked)
    assert [(type(read[x]), read[x]) for x in ("more_starts", "seed")] == [(int, 3), (int, 2)]


@pytest.mark.parametrize(
    ("verb", "name", "choices"),
    [
        (ik.sweep, "design", ("sobol", "shells")),
        (ik.equivalents, "criterion", ("noise", "paper")),
        (ik.sensitivity, "around", ("start", "fit")),
    ],
)
def test_a_word_is_one_of_the_choices(
    verb: Callable[..., Any], name: str, choices: tuple[str, ...]
) -> None:
    known = parameters_in_full(verb)
    assert read_arguments(known, {name: choices[1]}) == {name: choices[1]}
    with pytest.raises(ValueError, match=f"^{name} round: it is none of {', '.join(choices)}$"):
        read_arguments(known, {name: "round"})
    # Only a verb that finds the word itself takes none.
    if name == "around":
        assert read_arguments(known, {name: None}) == {name: None}
    else:
        with pytest.raises(ValueError, match=f"^{name} None"):
            read_arguments(known, {name: None})


def test_a_named_subject_as_a_path_is_told_to_be_a_text(frame: pd.DataFrame) -> None:
    with pytest.raises(InputError, match="Give the text 'reference'"):
        ik.fit(Path("reference"), frame)


def test_an_index_that_counts_rows_may_be_a_column(
    frame: pd.DataFrame, measured: ik.Laxity
) -> None:
    same(ik.read_laxity(frame.reset_index()), measured)
    words = frame.reset_index().astype({"index": str}).assign(index="x")
    with pytest.raises(InputError, match="column index: this column does not count rows"):
        ik.read_laxity(words)


def test_a_table_without_a_measured_value_is_said_to_be(frame: pd.DataFrame) -> None:
    blank = frame.assign(**dict.fromkeys(COORDINATES, np.nan))
    with pytest.raises(ValueError, match="no coordinate of the table is measured"):
        ik.fit("reference", blank)
