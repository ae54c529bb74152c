"""Diagnosis without one of its safeguards: each is there because the answer changes without it."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.blind.case import BlindCase, blind_case
from identknee.diagnosis import fitting
from identknee.diagnosis.candidates import library_variants
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.misfit import Projector
from identknee.diagnosis.noise_model import build_noise_model
from identknee.diagnosis.score import Signature, score_test
from identknee.model.effects.library import library
from identknee.subject.reference import reference_knee

SEED = 500


@pytest.fixture(scope="module")
def null() -> BlindCase:
    return blind_case(reference_knee(), seed=SEED, effect=None)


@pytest.fixture(scope="module")
def found(null: BlindCase) -> Investigation:
    diagnosis = investigate(reference_knee(), null.laxity)
    assert diagnosis is not None
    return diagnosis


def signatures(found: Investigation) -> list[Signature]:
    fitted = found.base.fitted
    return [x.signature for x in library_variants(fitted, library(fitted.model.knee))]


def test_without_the_projector_near_equivalent_fits_are_effects(found: Investigation) -> None:
    """A shift of the fitted parameters: nothing with the projector, a find without."""
    base = found.base
    jacobian = base.fitted.evaluation.jacobian
    _, size, right = np.linalg.svd(jacobian, full_matrices=False)
    there = base.fitted.residual_rows()
    moved = there + 8.0 * (jacobian @ right[0]) / size[0]
    nothing = Projector(basis=np.zeros((len(moved), 0)))
    given = signatures(found)
    test = score_test(base.fitted.projector, given, seed=0, scale="unknown")
    with_it = test.evaluate(moved)
    without = score_test(nothing, given, seed=0, scale="unknown").evaluate(moved)
    assert with_it.max_score == pytest.approx(test.evaluate(there).max_score, rel=1e-6)
    assert without.max_score > with_it.max_score + 2.0


def test_without_signs_a_structure_that_pushes_is_one(found: Investigation) -> None:
    base = found.base
    given = signatures(found)
    structure = next(x for x in given if x.name == "anterolateral")
    pushed = base.fitted.residual_rows()
    column = base.fitted.projector.project(structure.columns)[:, 0]
    pushed = pushed - 8.0 * column / np.linalg.norm(column)
    free = [replace(x, sign=0 * x.sign) for x in given if x.name == structure.name]
    own = [x for x in given if x.name == structure.name]
    with_signs = score_test(base.fitted.projector, own, seed=0).evaluate(pushed)
    without = score_test(base.fitted.projector, free, seed=0).evaluate(pushed)
    assert without.max_score > with_signs.max_score + 2.0


def test_without_nuisances_softer_contact_is_another_cause(
    null: BlindCase,
) -> None:
    """The generator's contact law is another one: the base fit must allow for it."""
    knee = reference_knee()
    sd = np.full(null.noise_free.coordinates.shape, 0.1)
    errorless = replace(null.noise_free, sd=sd, within_trial_correlation=0.3)
    allowed = fitting.base_model(knee, errorless.protocol)
    bare = allowed.with_effects(())
    noise = build_noise_model(sd, errorless.is_measured, correlation=0.3)
    start = allowed.parameters.center
    with_it = fitting.best_fit_from(allowed, errorless, noise, [start])
    without = fitting.best_fit_from(bare, errorless, noise, [start[: bare.parameters.n]])
    assert without.misfit > 2.0 * with_it.misfit
