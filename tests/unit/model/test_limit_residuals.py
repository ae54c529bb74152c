"""Limits of plausibility as residuals: closed forms, derivatives, and one term a knee."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bundled_knee import bundled_knee
from scipy.optimize import approx_fprime
from scipy.stats import norm

import identknee as ik
from identknee.calibrate.problem import BELIEFS, PLAUSIBILITY_TERM, evidence_terms, misfit_square
from identknee.checks.usable_trials import defined_everywhere, with_other_terms
from identknee.model.contact_loads import contact_values, meniscus_values
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitResiduals, standard_loads
from identknee.model.line_loads import strains_of, structure_values, tensions_of
from identknee.model.residuals import LaxityResiduals
from identknee.runs.errors import ValueRefused
from identknee.subject.knee import Knee, Uncertainty
from identknee.subject.menisci import with_menisci
from identknee.subject.plausibility import Limit, default_limits

PROTOCOL = ik.load_protocol("drawer")
STANDARD = "134 N anterior + 20 N compression, 20 deg"


def _limits(names: list[str]) -> tuple[Limit, ...]:
    own = Limit(form="normal", quantity=f"{names[0]}.tension_N@{STANDARD}", size=90.0, spread=20.0)
    return (*default_limits(names), own)


def _speaking(found: LimitResiduals, theta: np.ndarray) -> LimitResiduals:
    """The same limits at half of what the model has, so that all of them speak."""
    values = found.values(theta)
    sizes = [max(0.5 * abs(x), 0.1) if np.isfinite(x) else 1.0 for x in values]
    limits = [replace(x, size=y) for x, y in zip(found.limits, sizes, strict=True)]
    return LimitResiduals(model=found.model, limits=limits)


def test_each_form_has_its_density() -> None:
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    theta = model.parameters.start
    made = model.predict(theta)
    largest = tensions_of(model, made)[:, 0].max()
    strain = strains_of(model, made)[:, 0].max()
    limits = [
        Limit(form="strength", quantity="ACL.tension_N", size=0.8 * largest, spread=50.0),
        Limit(form="strength", quantity="ACL.strain_pct", size=0.5 * strain, spread=2.0),
    ]
    found = LimitResiduals(model=model, limits=limits)
    # The smooth maximum lies at most 0.1 log n above the largest.
    assert 0.0 <= found.values(theta)[0] - largest <= 0.1 * np.log(PROTOCOL.n)
    expected = -2.0 * norm.logcdf((0.8 * largest - found.values(theta)[0]) / 50.0)
    assert found.residuals(theta)[0] ** 2 == pytest.approx(expected, rel=1e-12)
    assert found.values(theta)[1] == pytest.approx(strain, abs=0.01 * np.log(PROTOCOL.n))


def test_within_begins_beyond_its_size() -> None:
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    theta = model.parameters.start
    contact = model.predict(theta).centres[:, :, 0]
    mean = float((contact[:, 0] - contact[:, 1]).mean())
    for size, expected in ((abs(mean) + 1.0, 0.0), (abs(mean) - 3.0, 3.0 / 7.0)):
        limit = Limit(
            form="within",
            quantity="contact.medial_N",
            less="contact.lateral_N",
            size=size,
            spread=7.0,
        )
        found = LimitResiduals(model=model, limits=[limit])
        assert abs(found.residuals(theta)[0]) == pytest.approx(expected, abs=1e-9)
        assert np.sign(found.residuals(theta)[0]) in (0.0, np.sign(mean))


def test_a_standard_load_is_predicted_beside_the_data() -> None:
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    theta = model.parameters.start
    limit = Limit(form="normal", quantity=f"ACL.tension_N@{STANDARD}", size=90.0, spread=20.0)
    alone = model.with_protocol(standard_loads([STANDARD]))
    tension = tensions_of(alone, alone.predict(theta))[0, 0]
    found = LimitResiduals(model=model, limits=[limit])
    assert found.residuals(theta)[0] == pytest.approx((tension - 90.0) / 20.0, rel=1e-9)


KNEES: dict[str, Callable[[], Knee]] = {
    "lines": ik.reference_knee,
    "bundles": bundled_knee,
    "menisci": lambda: with_menisci(ik.reference_knee()),
}


def test_a_compartment_bears_contact_and_meniscus() -> None:
    model = LaxityModel(knee=with_menisci(ik.reference_knee()), protocol=PROTOCOL)
    theta = model.parameters.start
    made = model.predict(theta)
    contact, menisci = (x(made)[:, :, 0] for x in (contact_values, meniscus_values))
    assert np.abs(np.diff(menisci.mean(axis=0))) > 1.0
    limit = Limit(
        form="within", quantity="contact.medial_N", less="contact.lateral_N", size=1.0, spread=1.0
    )
    found = LimitResiduals(model=model, limits=[limit])
    medial, lateral = (contact + menisci).mean(axis=0)
    assert found.values(theta)[0] == pytest.approx(medial - lateral, rel=1e-9)


@pytest.mark.parametrize("name", KNEES)
def test_derivatives_by_parameters_and_nuisances(name: str) -> None:
    knee = KNEES[name]()
    stated = Uncertainty(insertions_mm=1.0, registration_mm=1.0, registration_deg=1.0)
    knee = knee.with_uncertainty(stated)
    model = LaxityModel(knee=knee, protocol=PROTOCOL)
    theta = model.parameters.start
    found = LimitResiduals(model=model, limits=_limits([x.name for x in knee.ligaments]))
    found = _speaking(found, theta)
    assert np.count_nonzero(found.residuals(theta)) >= found.n - 2
    step = 1e-5 * np.maximum(1.0, np.abs(theta))
    forward = approx_fprime(theta, found.residuals, step)
    backward = approx_fprime(theta, found.residuals, -step)
    jacobian = found.jacobian(theta)
    np.testing.assert_allclose(
        jacobian, 0.5 * (forward + backward), atol=1e-6 * np.abs(jacobian).max()
    )


def test_a_trial_given_twice_adds_nothing() -> None:
    """One term a knee: the same belief does not count once for every trial."""
    knee = ik.reference_knee()
    limits = default_limits([x.name for x in knee.ligaments])
    limits = tuple(replace(x, size=0.3 * x.size) for x in limits if x.form == "strength")
    twice = replace(
        PROTOCOL,
        trials=tuple(f"trial {i}" for i in range(2 * PROTOCOL.n)),
        flexion_deg=np.tile(PROTOCOL.flexion_deg, 2),
        loads=np.tile(PROTOCOL.loads, (2, 1)),
    )
    deviances = []
    for protocol in (PROTOCOL, twice):
        model = LaxityModel(knee=knee, protocol=protocol)
        found = LimitResiduals(model=model, limits=limits)
        deviances.append(found.residuals(model.parameters.start) ** 2)
    assert deviances[0].max() > 3.0
    np.testing.assert_allclose(deviances[0], deviances[1], rtol=0.0, atol=0.01)


def test_limits_are_a_term_of_the_evidence_and_no_misfit() -> None:
    plain = ik.reference_knee()
    model = LaxityModel(knee=plain, protocol=PROTOCOL)
    theta = model.parameters.start
    made = model.predict(theta)
    laxity = ik.Laxity(
        protocol=PROTOCOL, coordinates=made.coordinates, sd=np.full((PROTOCOL.n, 5), 0.5)
    )
    limit = Limit(form="strength", quantity="ACL.tension_N", size=20.0, spread=10.0)
    knee = plain.with_plausibility([limit])
    residuals = LaxityResiduals(model=replace(model, knee=knee), laxity=laxity, weighting="noise")
    problem = with_other_terms(residuals)
    terms = {x.name: x for x in evidence_terms(problem, theta)}
    assert terms[PLAUSIBILITY_TERM].n == 1
    assert terms[PLAUSIBILITY_TERM].deviance > 10.0
    assert PLAUSIBILITY_TERM in BELIEFS
    assert misfit_square(problem, theta) == pytest.approx(0.0, abs=1e-6)
    everywhere = defined_everywhere(residuals)
    assert everywhere.residuals(theta)[-1] == problem.residuals(theta)[-1]
    with pytest.raises(ValueRefused):
        with_other_terms(replace(residuals, weighting="unit"))


def test_signs_of_a_standard_load_are_read() -> None:
    made = standard_loads(["-10 N·m varus, -5 deg", "10 Nm valgus, 5 deg"])
    assert made.flexion_deg.tolist() == [-5.0, 5.0]
    assert made.loads.tolist() == 2 * [[0.0, -10.0, 0.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    "words",
    [
        "anterior, 30 deg",
        "134 N anterior",
        "134 N forwards, 30 deg",
        "134 N anterior, 30",
        "134 kN anterior, 30 deg",
        "10 N varus, 30 deg",
        "anterior 134, 30 deg",
    ],
)
def test_a_standard_load_that_cannot_be_read_is_refused(words: str) -> None:
    with pytest.raises(ValueRefused):
        standard_loads([words])


def test_a_limit_of_what_the_knee_lacks_is_refused() -> None:
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    limit = Limit(form="strength", quantity="POL.tension_N", size=250.0, spread=80.0)
    with pytest.raises(ValueRefused):
        LimitResiduals(model=model, limits=[limit])


def test_a_structure_beside_the_ligaments_has_its_strength_where_the_model_has_it() -> None:
    knee = ik.reference_knee()
    limits = default_limits([x.name for x in knee.ligaments])
    plain = LimitResiduals(model=LaxityModel(knee=knee, protocol=PROTOCOL), limits=limits)
    deep = "deep_mcl.tension_N"
    assert deep not in {x.name for x in plain.limits}
    model = LaxityModel(knee=knee, protocol=PROTOCOL, effects=(effect_named(knee, "deep_mcl"),))
    theta = np.array(model.parameters.start)
    theta[model.parameters.index("deep_mcl.stiffness_kN")] = 3.0
    theta[model.parameters.index("deep_mcl.reference_strain_pct")] = 5.0
    found = LimitResiduals(model=model, limits=limits)
    assert {x.name for x in found.limits} - {x.name for x in plain.limits} == {deep}
    k = [x.name for x in found.limits].index(deep)
    largest = np.nanmax(structure_values(model, model.predict(theta), "deep_mcl")[0])
    assert 0.0 <= found.values(theta)[k] - largest <= 0.1 * np.log(PROTOCOL.n)
    speaking = _speaking(found, theta)
    slopes = approx_fprime(theta, lambda x: float(speaking.residuals(x)[k]), 1e-6)
    assert abs(slopes[-8:]).max() > 0.0
    scale = abs(slopes).max()
    np.testing.assert_allclose(speaking.jacobian(theta)[k], slopes, atol=2e-4 * scale)
