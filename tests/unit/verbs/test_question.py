"""What verbs were asked, as their answers say it, and priors of ligament parameters in all."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import short_protocol
from quick_calls import ALL_BUT_ACL, quick, quick_verbs

import identknee as ik
from identknee.calibrate.problem import LIGAMENT_TERM, TABLE_TERM
from identknee.subject.knee import StatedPrior
from identknee.verbs.answer import IN_WORDS

pytestmark = pytest.mark.usefixtures("no_conventions")

NOISE = "0.5mm,0.5deg"
NAMES = ("ACL.stiffness_kN", "ACL.reference_strain_pct")


@pytest.fixture(scope="module")
def laxity(tmp_path_factory: pytest.TempPathFactory) -> ik.Laxity:
    """The reference knee under ten trials, with noise."""
    knee = ik.reference_knee()
    protocol = ik.load_protocol(short_protocol(tmp_path_factory.mktemp("question")))
    return ik.add_noise(ik.simulate(knee, protocol).laxity, sd_mm=0.5, sd_deg=0.5, seed=1)


@pytest.fixture(scope="module")
def certain() -> ik.Knee:
    """The reference knee, its ACL said to be other than it is and known to a hundredth."""
    priors = {
        NAMES[0]: StatedPrior(log_sd=0.01, center=7.0),
        NAMES[1]: StatedPrior(sd=0.01, center=4.0),
    }
    return replace(ik.reference_knee(), priors=priors)


def _best(answer: Any) -> np.ndarray:
    """The two free parameters at the best fit that an answer found."""
    if isinstance(answer, ik.Calibration):
        return np.array([answer.parameter_set[x] for x in NAMES])
    if hasattr(answer, "survey"):
        return np.asarray(answer.survey.target)
    if hasattr(answer, "fisher"):
        return np.asarray(answer.fisher.theta)
    if hasattr(answer, "fit"):
        return np.array([answer.fit[x] for x in NAMES])
    if hasattr(answer, "draws"):
        return np.array([answer.parameters[x].mean for x in NAMES])
    return np.array([answer.optimum_by_name[x] for x in NAMES])


@pytest.mark.parametrize(
    "verb", quick_verbs(slow=("sample", "design", "equivalents", "information"))
)
def test_priors_count_where_they_are_asked_for(
    verb: str, laxity: ik.Laxity, certain: ik.Knee
) -> None:
    answers = {
        asked: quick(verb, certain, laxity, noise=NOISE, fixed=ALL_BUT_ACL, priors=asked)
        for asked in (True, False)
    }
    for asked, answer in answers.items():
        assert answer.question is not None
        assert answer.question.priors is asked
        terms = {x.name: x for x in answer.evidence}
        assert (LIGAMENT_TERM in terms) is asked
        assert terms[TABLE_TERM].n == laxity.is_measured.sum()
    if verb == "design":
        # It holds no parameter set: priors that hold both leave the trials nothing to narrow.
        designs = [x for x in answers.values() if isinstance(x, ik.Design)]
        with_priors, without = (x.choice.narrowing.now for x in designs)
        assert np.all(with_priors < 0.1 * without)
        return
    np.testing.assert_allclose(_best(answers[True]), [7.0, 4.0], atol=0.3)
    assert np.all(np.abs(_best(answers[False]) - [7.0, 4.0]) > 1.0)


def test_a_question_says_what_was_asked_and_in_what_it_differs(laxity: ik.Laxity) -> None:
    knee = ik.reference_knee()
    first, last = laxity.protocol.trials[0], laxity.protocol.trials[-1]
    quick: Any = {"fixed": ALL_BUT_ACL, "more_starts": 0}
    plain = ik.fit(knee, laxity, noise=NOISE, **quick).question
    assert plain is not None
    assert plain.trials == laxity.protocol.trials
    assert (plain.weighting, plain.noise_mm, plain.noise_deg) == ("noise", 0.5, 0.5)
    assert plain.fixed == tuple(ALL_BUT_ACL)
    other = ik.fit(
        knee, laxity, noise="1mm,0.5deg", leave_out=[last], bounds=[f"{NAMES[0]}=1:30"], **quick
    ).question
    assert other is not None
    assert first in other.trials
    assert last not in other.trials
    assert other.left_out_by_name == (last,)
    assert plain.differences(plain) == ()
    changed = {IN_WORDS[x] for x in ("trials", "noise_mm", "bounds")}
    assert set(plain.differences(other)) == changed


@pytest.mark.usefixtures("short_searches")
@pytest.mark.slow
def test_what_the_table_contradicts_is_left_out_of_every_verb_alike() -> None:
    """One trial of the measured knee; `keep` keeps it."""
    table = ik.example_laxity("s192803")
    for keep, n in ((None, table.n - 1), (["Valgus_60"], table.n)):
        found = ik.fit("s192803", table, more_starts=0, budget=1, keep=keep)
        assert found.question is not None
        assert len(found.question.trials) == n
        assert np.isnan(found.data.coordinates).any() == (keep is None)
        codes = [(x.code, x.values.get("is_left_out")) for x in found.findings]
        assert (("trial-against-course", True) in codes) == (keep is None)


def test_the_question_is_in_the_files(laxity: ik.Laxity, tmp_path: Path) -> None:
    found = ik.fit("reference", laxity, noise=NOISE, fixed=ALL_BUT_ACL, more_starts=0, out=tmp_path)
    loaded = ik.load(tmp_path)
    assert found.question is not None
    assert loaded.question is not None
    assert found.question.differences(loaded.question) == ()
    shown = [[(x.name, x.n, x.deviance) for x in one.evidence] for one in (found, loaded)]
    assert shown[0] == shown[1]
    assert shown[0][0][:2] == (TABLE_TERM, int(laxity.is_measured.sum()))
