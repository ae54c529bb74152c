"""What data determine is the same for a knee posed, mirrored, renamed and with a fifth ligament."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from held import both_of, fixing
from posed_knees import FIFTH, NAMES, posed_reference
from typer.testing import CliRunner

from identknee.cli.app import app
from identknee.subject.folder import write_subject

# From seventeen points searches end where they do from three: both knees are asked the same.
pytestmark = pytest.mark.usefixtures("few_starts")

# Poses agree to 1e-9 mm; searches stop within 1e-4 of the deviance, which moves what they find by
# up to a hundredth of a standard deviation where it is flat, and by far less at a crossing.
SAME = 1e-4
FREE = (
    f"{NAMES[2]}.stiffness_kN",
    f"{NAMES[2]}.reference_strain_pct",
    f"{FIFTH.name}.stiffness_kN",
)
HELD = tuple(x for x in both_of(*NAMES, FIFTH.name) if x not in FREE)
PROTOCOL = """
format = 1
[[ramps]]
flexion_deg = [0, 30]
load = "internal_moment_Nm"
values = [-4, 0, 4]
[[ramps]]
flexion_deg = [0, 30]
load = "varus_moment_Nm"
values = [-4, 4]
"""
WORDS: dict[str, tuple[object, ...]] = {
    "information": (),
    "profile": ("--forces", "flexion0_varus4Nm"),
    "equivalents": ("--n-sets", 3, "--forces", "none"),
    "sweep": ("--n-starts", 4, "--paths", 2),
}
Summaries = Callable[[str], tuple[dict[str, Any], dict[str, Any]]]


@pytest.fixture(scope="module")
def summaries(tmp_path_factory: pytest.TempPathFactory) -> Summaries:
    """What a verb says of the knee where it is made, and of the same one elsewhere, left."""
    folder = tmp_path_factory.mktemp("same")
    here = write_subject(posed_reference(side="right", scale=1.0, is_moved=False), folder / "here")
    there = write_subject(posed_reference(3, side="left", scale=1.0), folder / "there")
    protocol = folder / "short.toml"
    protocol.write_text(PROTOCOL, encoding="utf-8")
    _run("simulate", here, "--protocol", protocol, "--noise", "0.5mm,0.5deg", "--out", folder)
    held = fixing(HELD)

    def both(verb: str) -> tuple[dict[str, Any], dict[str, Any]]:
        found = []
        for subject in (here, there):
            out = folder / verb / subject.name
            _run(verb, subject, folder / "laxity.csv", *held, *WORDS[verb], "--out", out)
            found.append(json.loads((out / "result.json").read_text(encoding="utf-8")))
        return found[0], found[1]

    return both


@pytest.mark.slow
def test_the_information_is_the_same(summaries: Summaries) -> None:
    here, there = summaries("information")
    assert set(here["sd"]) == set(FREE)
    assert there["sd"] == pytest.approx(here["sd"], rel=SAME)
    for name in ("n_above_noise", "structure"):
        assert there[name] == here[name]


@pytest.mark.slow
def test_the_profiles_are_the_same(summaries: Summaries) -> None:
    here, there = summaries("profile")
    assert set(here["parameters"]) == set(FREE)
    assert set(here["quantities"]) == {
        f"{x}.tension_N@flexion0_varus4Nm" for x in (*NAMES, FIFTH.name)
    }
    for group in ("parameters", "quantities"):
        for name, mine in here[group].items():
            theirs = there[group][name]
            for key in ("verdict", "lower_status", "upper_status"):
                assert theirs[key] == mine[key], name
            # An open end is None; its status, compared above, says so.
            for key in (x for x in ("value", "lower", "upper") if mine[x] is not None):
                assert theirs[key] == pytest.approx(mine[key], rel=SAME, abs=SAME), name


@pytest.mark.slow
def test_the_equivalent_sets_reach_as_far(summaries: Summaries) -> None:
    here, there = summaries("equivalents")
    assert there["diameter"] == pytest.approx(here["diameter"], rel=SAME)
    for name in FREE:
        for key in ("lower", "upper"):
            mine, theirs = here["parameters"][name], there["parameters"][name]
            assert theirs[key] == pytest.approx(mine[key], rel=SAME), name


@pytest.mark.slow
def test_the_searches_end_alike(summaries: Summaries) -> None:
    here, there = summaries("sweep")
    assert there["polished_outcomes"] == here["polished_outcomes"]
    assert there["objective"] == pytest.approx(here["objective"], rel=SAME)
    for mine, theirs in zip(here["basins"], there["basins"], strict=True):
        assert theirs["parameters"] == pytest.approx(mine["parameters"], rel=SAME)


def _run(*words: object) -> None:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
