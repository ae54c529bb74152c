"""Results side by side: what compares, what does not, and under which names."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import refused, run
from golden_texts import Golden
from held import both_of

import identknee as ik
from identknee.calibrate.problem import LIGAMENT_TERM, TABLE_TERM, EvidenceTerm
from identknee.report.answers.compare import NO_SETS, ComparisonPresenter
from identknee.report.comparison import Comparison
from identknee.report.page.page import report_drawings, report_html, report_tables
from identknee.report.presenter import statements_of
from identknee.report.results import found_results
from identknee.verbs.answer import IN_WORDS
from identknee.verbs.files import write_answer

pytestmark = pytest.mark.usefixtures("no_drawings")

HELD = both_of("PCL", "LCL", "MCL")
ACL = "ACL.stiffness_kN"
SECTION = 'id="comparison-'
HOW: dict[str, Any] = {"noise": "0.5mm,0.5deg", "fixed": HELD, "priors": False}


@pytest.fixture(scope="module")
def folders(few_starts: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fits and profiles of a knee, and of the same knee with a soft ACL."""
    whole = tmp_path_factory.mktemp("two")
    knee = ik.reference_knee()
    for name, stiffness in (("intact", 10.0), ("torn", 2.0)):
        clean = ik.simulate(knee, "drawer", {ACL: stiffness}).laxity
        data = ik.add_noise(clean, sd_mm=0.5, sd_deg=0.5, seed=1)
        ik.fit(knee, data, more_starts=0, out=whole / f"fit-{name}", **HOW)
        ik.profile(knee, data, parameters=[ACL], out=whole / f"profile-{name}", **HOW)
    return whole


def compared(folders: Path, *names: str, **more: Any) -> Comparison:
    made = ik.compare([folders / x for x in names], **more)
    assert isinstance(made, Comparison)
    return made


def said_of_sets(answer: Comparison) -> str:
    """What is said first."""
    return statements_of(answer)[0].sentence


def said_of_misfit(answer: Comparison) -> str:
    (sentence,) = (x.sentence for x in statements_of(answer) if "deviance" in x.sentence)
    return sentence


def test_sets_are_set_side_by_side_under_the_names_given(folders: Path) -> None:
    made = compared(folders, "profile-intact", "profile-torn", names=["intact", "ACL torn"])
    (acl,) = [x for x in made.parameters if x.name == ACL]
    assert [x.name for x in acl.stands] == ["intact", "ACL torn"]
    profiles = [ik.load(folders / f"profile-{x}") for x in ("intact", "torn")]
    for stand, own in zip(acl.stands, profiles, strict=True):
        assert isinstance(own, ik.Profiles)
        profile = own.parameters[ACL]
        assert (stand.lower, stand.upper) == (profile.lower, profile.upper)
        assert stand.estimate == profile.optimum_value
        assert stand.method == "profile"
    lower = acl.stands[0].lower
    assert lower is not None
    assert acl.stands[1].upper is not None
    assert acl.is_apart == (acl.stands[1].upper < lower)
    assert acl.is_apart
    assert "ACL stiffness" in said_of_sets(made)
    assert "overlap" not in said_of_sets(made)
    frame = made.to_dataframe("values-one-by-one")
    own = frame[(frame["result"] == "ACL torn") & (frame["quantity"] == "ACL stiffness")]
    assert own["upper end"].tolist() == [acl.stands[1].upper]


def test_sets_that_overlap_are_not_apart(folders: Path) -> None:
    made = compared(folders, "profile-intact", "profile-intact", names=["a", "b"])
    assert not any(x.is_apart for x in made.parameters)
    assert "overlap" in said_of_sets(made)
    assert "stiffness" not in said_of_sets(made)
    assert "apart" not in str(made)


def test_what_was_held_is_a_value_without_a_set(folders: Path) -> None:
    made = compared(folders, "fit-intact", "fit-torn")
    held = [x for x in made.parameters if x.name in HELD]
    assert len(held) == 6
    assert all(y.status == "held" and not y.has_set for x in held for y in x.stands)
    assert not any(x.is_apart for x in made.parameters)
    assert NO_SETS in said_of_sets(made)
    assert made.names == ("fit-intact", "fit-torn")


def test_forces_and_laxity_are_those_of_the_fits(folders: Path) -> None:
    made = compared(folders, "fit-intact", "fit-torn")
    fits = [ik.load(folders / f"fit-{x}") for x in ("intact", "torn")]
    one, other = [x for x in fits if isinstance(x, ik.Calibration)]
    apart = np.abs(one.tension_N - other.tension_N)
    assert len(made.forces) == apart.size
    assert made.forces[0].spread == pytest.approx(np.max(apart))
    wanted = np.sqrt(np.mean((one.coordinates - other.coordinates) ** 2, axis=0))
    assert made.laxity_difference[1] == pytest.approx(wanted)
    assert made.laxity_difference[0] == pytest.approx(0.0)
    assert made.n_trials_shared == (9, 9)


def test_misfit_compares_of_the_same_data_and_noise_alone(folders: Path) -> None:
    other = compared(folders, "fit-intact", "fit-torn")
    assert not other.is_misfit_comparable
    assert "data" in {x.what for x in other.differences}
    assert "data" in other.why_not
    assert other.why_not in " ".join(x.sentence for x in statements_of(other))
    fitted = ik.load(folders / "fit-intact")
    assert isinstance(fitted, ik.Calibration)
    assert fitted.question is not None
    worse = [EvidenceTerm(name=TABLE_TERM, n=1, deviance=fitted.best_deviance + 3.0, share=1.0)]
    worse += [EvidenceTerm(name=LIGAMENT_TERM, n=1, deviance=9.0, share=1.0)]
    stiff = replace(fitted, evidence=tuple(worse))
    made = ik.compare({"soft": fitted, "stiff": stiff})
    assert made.is_misfit_comparable
    # Priors are no data.
    lowest, _, higher = said_of_misfit(made).partition("lowest")
    assert "soft" in lowest
    assert higher.endswith("stiff by 3.")
    assert [x.n_fitted for x in made.misfits] == [2, 2]
    quiet = replace(fitted, question=replace(fitted.question, noise_mm=0.1))
    noisy = ik.compare([fitted, quiet], names=["a", "b"])
    assert noisy.why_not.endswith(f" {IN_WORDS['noise_mm']}")
    assert [x.what for x in noisy.differences] == [IN_WORDS["noise_mm"]]
    assert noisy.differences[0].values == ("0.5 mm", "0.1 mm")
    unknown = ik.compare([fitted, replace(fitted, question=None)], names=["a", "b"])
    assert "not known" in unknown.why_not


def test_the_same_deviance_is_called_so_and_a_simulation_fits_nothing(folders: Path) -> None:
    made = compared(folders, "fit-intact", "profile-intact")
    own = made.names
    assert own == ("fit-intact", "profile-intact")
    assert all(x in said_of_misfit(made) for x in own)
    assert "lowest" not in said_of_misfit(made)
    knee = ik.reference_knee()
    two = {str(x): ik.simulate(knee, "drawer", {ACL: x}) for x in (10.0, 2.0)}
    simulated = ik.compare(two)
    assert [x.n_fitted for x in simulated.misfits] == [None, None]
    (acl,) = [x for x in simulated.parameters if x.name == ACL]
    assert [(x.estimate, x.method) for x in acl.stands] == [
        (10.0, "simulated with"),
        (2.0, "simulated with"),
    ]
    tensions = [x.tension_N for x in two.values()]
    assert simulated.forces[0].spread == pytest.approx(np.max(np.abs(tensions[0] - tensions[1])))
    assert simulated.why_not.endswith("no data")


def test_what_differs_beside_the_numbers_is_listed(folders: Path) -> None:
    fitted = ik.load(folders / "fit-intact")
    assert fitted.record is not None
    assert fitted.question is not None
    settings = {**fitted.record.settings, "method": "complex", "out": "elsewhere"}
    inputs = {**fitted.record.inputs, "subject": "f" * 64}
    other = replace(
        fitted,
        record=replace(fitted.record, settings=settings, inputs=inputs),
        question=replace(fitted.question, fixed=(), uncertainty={"insertions_mm": "2 mm"}),
    )
    found = {x.what: x.values for x in ik.compare([fitted, other], names=["a", "b"]).differences}
    assert found["fit --method"] == ("as usual", "complex")
    assert found["knee"][1].endswith("(ffffffff)")
    assert found["fixed parameters"][1] == "none"
    uncertain = IN_WORDS["uncertainty"]
    assert found[uncertain][1] == "insertions_mm 2 mm"
    assert set(found) == {"fit --method", "knee", "fixed parameters", uncertain}


def test_options_that_differ_are_written_as_one_types_them(folders: Path) -> None:
    one = ik.load(folders / "profile-intact")
    assert one.record is not None
    settings = {**one.record.settings, "parameters": [ACL, HELD[0]]}
    two = replace(one, record=replace(one.record, settings=settings))
    found = {x.what: x.values for x in ik.compare([one, two], names=["a", "b"]).differences}
    assert found["profile --parameter"] == (ACL, f"{ACL}, {HELD[0]}")


def test_one_folder_may_hold_several_results_of_one_table(folders: Path, tmp_path: Path) -> None:
    for name in ("intact", "torn"):
        for verb in ("fit", "profile"):
            answer = ik.load(folders / f"{verb}-{name}")
            (tmp_path / name / verb).mkdir(parents=True)
            write_answer(tmp_path / name / verb, answer)
    made = ik.compare([tmp_path / "intact", tmp_path / "torn"])
    assert made.names == ("intact", "torn")
    assert made.items[0].verbs == ("fit", "profile")
    (acl,) = [x for x in made.parameters if x.name == ACL]
    assert all(x.method == "profile" for x in acl.stands)
    assert str(folders) in refused("compare", folders, tmp_path / "torn", "--out", tmp_path / "x")


MISTAKES = (
    "compare fit-intact",
    "compare fit-intact fit-torn --name a",
    "compare fit-intact fit-torn --name a --name a",
    "compare fit-intact none",
)


def test_mistakes_are_answered_by_one_sentence(
    folders: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.chdir(folders)
    said = [f"$ identknee {x}\n{refused(*x.split(), '--out', 'out')}" for x in MISTAKES]
    golden("said/refusals-to-compare", "\n\n".join(said))
    assert not Path("out").exists()


def test_the_command_writes_files_figures_and_a_page_with_the_names(
    folders: Path, tmp_path: Path
) -> None:
    words = [folders / "profile-intact", folders / "profile-torn", "--name", "left"]
    result = run("compare", *words, "--name", "right, torn", "--out", tmp_path / "both")
    assert result.exit_code == 0, result.output
    assert "right, torn" in result.stdout
    again = ik.load(tmp_path / "both")
    assert isinstance(again, Comparison)
    assert again.names == ("left", "right, torn")
    assert again.record is not None
    assert set(again.record.inputs) == {"results 1", "results 2"}
    assert (tmp_path / "both" / "parameters.png").read_bytes().startswith(b"\x89PNG")
    page = tmp_path / "page.html"
    assert run("report", tmp_path / "both", "--out", page).exit_code == 0
    assert "right, torn" in page.read_text("utf-8")


def test_a_page_of_several_knees_names_them_and_sets_them_side_by_side(
    folders: Path, tmp_path: Path
) -> None:
    for name in ("intact", "torn"):
        answer = ik.load(folders / f"profile-{name}")
        assert answer.record is not None
        inputs = {**answer.record.inputs, "subject": name * 9}
        (tmp_path / name).mkdir()
        write_answer(tmp_path / name, replace(answer, record=replace(answer.record, inputs=inputs)))
    results = found_results(tmp_path)
    page = report_html(results)
    assert "reference (intact)" in page
    assert "reference (torn)" in page
    assert "number 1" not in page
    assert page.count(SECTION) == 2  # the section and its heading
    assert "compare-parameters" in dict(report_drawings(results))
    assert "compare-parameters-side-by-side" in report_tables(results)
    run("compare", tmp_path / "intact", tmp_path / "torn", "--name", "before", "--name", "after",
        "--out", tmp_path / "c")  # fmt: skip
    named = report_html(found_results(tmp_path))
    assert "reference (before)" in named
    assert named.count(SECTION) == 2


def test_two_tables_of_one_knee_stand_side_by_side_on_its_page(folders: Path) -> None:
    results = [*found_results(folders / "fit-intact"), *found_results(folders / "fit-torn")]
    page = report_html(results)
    assert page.count(SECTION) == 2
    _, _, section = page.partition(SECTION)
    assert section.index("fit-intact") < section.index("fit-torn")
    alone = report_html(found_results(folders / "fit-intact"))
    assert SECTION not in alone


def test_figures_show_every_result(folders: Path) -> None:
    made = compared(folders, "fit-intact", "profile-torn")
    drawn = {x.name: x.figure for x in ComparisonPresenter().drawings(made, "", None)}
    assert list(drawn) == ["parameters"]
    made = compared(folders, "fit-intact", "fit-torn")
    drawn = {x.name: x.figure for x in ComparisonPresenter().drawings(made, "", None)}
    assert list(drawn) == ["parameters", "forces"]
    (legend,) = drawn["parameters"].legends
    assert [x.get_text() for x in legend.get_texts()] == ["fit-intact", "fit-torn"]
