"""`identknee profile`, from its words to its files and sentences."""

from dataclasses import replace
from pathlib import Path

import pytest
import xarray
from cli_runs import refused, run, summary_in
from held import both_of, fixing
from scipy.stats import chi2

import identknee as ik
from identknee.subject.ligament import LigamentGroup

# What stays free beside the two costs time and changes nothing that is asked here.
HELD = fixing(both_of("ACL", "PCL", "MCL"))
TWO = ("--parameter", "LCL.stiffness_kN", "--parameter", "LCL.reference_strain_pct")


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference knee under nine of the 63 trials, 0.5 mm and 0.5 deg."""
    knee, protocol = ik.reference_knee(), ik.load_protocol("seed63").select(range(0, 63, 7))
    laxity = ik.simulate(knee, protocol).laxity
    noisy = ik.add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=1)
    return ik.write_laxity(noisy, tmp_path_factory.mktemp("profile") / "data.csv")


def test_the_keys_that_checks_read_are_there(noisy: Path, tmp_path: Path) -> None:
    trial = ik.read_laxity(noisy).protocol.trials[0]
    result = run(
        *("profile", "reference", noisy, *TWO, "--fix", "PCL.stiffness_kN", "--out", tmp_path),
        *("--quantity", f"varus_deg@{trial}", "--forces", trial),
    )
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path)
    assert list(summary["parameters"]) == ["LCL.stiffness_kN", "LCL.reference_strain_pct"]
    for entry in summary["parameters"].values():
        assert {"lower", "upper", "lower_status", "upper_status"} < set(entry)
        assert entry["n_simulations"] > 0
        assert (entry["lower"] is None) == (entry["lower_status"] != "closed")
        assert entry["verdict"] in {"identifiable", "one_sided", "practically_nonidentifiable"}
    assert f"varus_deg@{trial}" in summary["quantities"]
    assert f"MCL.tension_N@{trial}" in summary["quantities"]
    assert "verdict" in result.stdout
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert {"profile", "profile_quantities"} <= set(tree.children)


def test_a_grouped_knee_is_asked_for_its_groups_and_contact(noisy: Path) -> None:
    crossed = LigamentGroup(name="cruciates", members=("ACL", "PCL"))
    knee = replace(ik.reference_knee(), groups=(crossed,))
    trial = ik.read_laxity(noisy).protocol.trials[0]
    contact = [
        f"contact.medial_N@{trial}",
        f"contact.lateral_z_mm@{trial}",
        f"ACL.strain_pct@{trial}",
    ]
    answer = ik.profile(
        *(knee, noisy),
        parameters=["LCL.stiffness_kN"],
        quantities=contact,
        forces=[trial],
        fixed=["LCL.reference_strain_pct", "MCL.stiffness_kN", "MCL.reference_strain_pct"],
        noise="0.5mm,0.5deg",
        budget=12,
    )
    forces = [f"{x}.tension_N@{trial}" for x in ("cruciates", "LCL", "MCL")]
    assert list(answer.quantities) == [*contact, *forces]
    medial, lateral_z, _ = (answer.quantities[x] for x in contact)
    assert medial.optimum_value > 0.0
    assert 10.0 < lateral_z.optimum_value < 40.0
    assert [answer.quantities[x].unit for x in contact] == ["N", "mm", "%"]


def test_a_trial_without_prediction_at_the_fit_is_named(noisy: Path, tmp_path: Path) -> None:
    path = tmp_path / "far.toml"
    path.write_text(
        'format = 1\nname = "far"\n[[ramps]]\nflexion_deg = [30]\n'
        'load = "internal_moment_Nm"\nvalues = [45]\n',
        encoding="utf-8",
    )
    name = "LCL.tension_N@flexion30_internal45Nm"
    words = ("profile", "reference", noisy, *TWO, *HELD, "--trials", path, "--quantity", name)
    said = refused(*words, "--out", tmp_path)
    assert said.startswith(f"{name} ")
    assert "no prediction" in said


def test_the_same_command_again_resumes_to_the_same(noisy: Path, tmp_path: Path) -> None:
    words = ("profile", "reference", noisy, *TWO, *HELD, "--out", tmp_path)
    assert run(*words).exit_code == 0
    first = summary_in(tmp_path)["parameters"]
    assert run(*words).exit_code == 0
    assert summary_in(tmp_path)["parameters"] == first
    assert run(*words, "--level", "0.9").exit_code == 0
    assert summary_in(tmp_path)["parameters"] != first


def test_at_a_rejected_fit_nothing_is_known(noisy: Path, tmp_path: Path) -> None:
    """The noise is stated to half of what it is; as it is, nothing is conditional."""
    words = ("profile", "reference", noisy, *TWO, *HELD)
    result = run(*words, "--noise", "0.25mm,0.25deg", "--out", tmp_path / "half")
    summary = summary_in(tmp_path / "half")
    assert summary["conditional_on_misfit"] is True
    (found,) = [x for x in summary["findings"] if x["code"] == "conditional-on-misfit"]
    n = int(ik.read_laxity(noisy).is_measured.sum())
    assert found["values"]["n"] == n
    assert found["values"]["deviance"] == pytest.approx(summary["deviance"])
    assert found["values"]["p"] == pytest.approx(chi2.sf(summary["deviance"], n - 2))
    assert "misfit-improbable" not in {x["code"] for x in summary["findings"]}
    for entry in summary["parameters"].values():
        assert entry["verdict"] == "identifiable"
        assert entry["conditional_on_misfit"] is True
        assert entry["lower_side"]["origin"] == entry["upper_origin"] == "data"
    # It opens with the numbers and the command that comes next.
    first = " ".join(result.stdout.split()).partition("At 95 %")[0]
    assert f"{found['values']['deviance']:.4g}" in first
    assert f"identknee diagnose reference {noisy} --noise 0.25mm,0.25deg" in first
    assert " known" not in result.stdout.replace("no value is known", "")

    run(*words, "--out", tmp_path / "whole")
    whole = summary_in(tmp_path / "whole")
    assert whole["conditional_on_misfit"] is False
    assert [x["conditional_on_misfit"] for x in whole["parameters"].values()] == [False, False]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--parameter", "LCL.stifness"), "parameter 'LCL.stifness'"),
        (("--pair", "LCL.stiffness_kN"), "second name"),
        (("--quantity", "varus"), "'varus'"),
        (("--quantity", "contact.force_N@a"), "contact.medial_N@TRIAL"),
        (("--forces", "nowhere"), "trial 'nowhere'"),
        (("--level", "1.5"), "0 and 1, got 1.5"),
        (("--pair", "LCL.stiffness_kN,LCL.stiffness_kN"), "different parameters"),
        (("--workers", "0"), "'--workers'"),
        (("--parameter", "LCL.stiffness_kN", "--fix", "LCL.stiffness_kN"), "--fix holds"),
    ],
)
def test_wrong_words_are_refused(
    noisy: Path, tmp_path: Path, words: tuple[str, ...], sentence: str
) -> None:
    assert sentence in refused("profile", "reference", noisy, *words, "--out", tmp_path)
