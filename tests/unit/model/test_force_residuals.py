"""Measured forces: read from tables, compared with predictions, and what they add to a fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bundled_knee import bundled_knee

import identknee as ik
from identknee.calibrate.problem import FORCE_TERM, TABLE_TERM
from identknee.checks.usable_trials import defined_everywhere, with_other_terms
from identknee.laxity.experiment_tables import read_experiments
from identknee.laxity.forces import MeasuredForces
from identknee.model.force_residuals import ForceResiduals
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import quantity_named
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.subject.knee import Uncertainty

KNEE = ik.reference_knee().with_uncertainty(Uncertainty(insertions_mm=1.0))
PROTOCOL = ik.load_protocol("drawer")
NAMES = ("ACL.tension_N", "contact.medial_N")


def _laxity(names: tuple[str, ...] = NAMES, sd: float = 5.0) -> ik.Laxity:
    """Laxity and forces of the reference knee without noise; the first trial has no force."""
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    found = model.predict(model.parameters.start)
    values = np.array(
        [[quantity_named(model, f"{x}@{t}").value(found) for x in names] for t in PROTOCOL.trials]
    )
    values[0] = np.nan
    forces = MeasuredForces(names=names, values=values, sd=np.full(values.shape, sd))
    return ik.Laxity(
        protocol=PROTOCOL,
        coordinates=found.coordinates,
        sd=np.full((PROTOCOL.n, 5), 0.5),
        forces=forces,
    )


def _theta(model: LaxityModel) -> Array:
    p = model.parameters
    steps = np.random.default_rng(5).uniform(-0.3, 0.3, p.n) * p.prior_sd
    return np.where(p.is_log, p.start * np.exp(steps), p.start + steps)


def test_forces_are_read_and_written(tmp_path: Path) -> None:
    laxity = _laxity()
    path = ik.write_laxity(laxity, tmp_path / "a.csv")
    header = path.read_text().splitlines()[0].split(",")
    assert header[-4:] == [
        "ACL_tension_N",
        "contact_medial_N",
        "sd_ACL_tension_N",
        "sd_contact_medial_N",
    ]
    again = ik.read_laxity(path)
    assert again.forces is not None
    assert laxity.forces is not None
    assert again.forces.names == NAMES
    np.testing.assert_array_equal(again.forces.values, laxity.forces.values)
    assert again.n_values == 5 * PROTOCOL.n + 2 * (PROTOCOL.n - 1)
    chosen = again.select([0, 1])
    assert chosen.forces is not None
    assert chosen.forces.is_measured.tolist() == [[False, False], [True, True]]
    other = _laxity(("LCL.tension_N",))
    both = read_experiments([again, replace(other, protocol=replace(PROTOCOL, name="b"))])
    assert both.forces is not None
    assert both.forces.names == (*NAMES, "LCL.tension_N")
    n = PROTOCOL.n - 1
    assert both.forces.is_measured.sum(axis=0).tolist() == [n, n, n]


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        (",sd_ACL_tension_N,", ",sd_LCL_tension_N,", "sd_"),
        (",5.0,5.0\n", ",,5.0\n", "standard deviation"),
        (",5.0,5.0\n", ",0,5.0\n", "standard deviation"),
    ],
)
def test_a_force_needs_its_error(old: str, new: str, named: str, tmp_path: Path) -> None:
    path = ik.write_laxity(_laxity(), tmp_path / "a.csv")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ik.InputError, match=named):
        ik.read_laxity(path)


def test_residuals_are_differences_in_units_of_their_errors() -> None:
    laxity = _laxity()
    assert laxity.forces is not None
    model = LaxityModel(knee=KNEE, protocol=PROTOCOL)
    problem = ForceResiduals(model=model, forces=laxity.forces)
    assert problem.n == 2 * (PROTOCOL.n - 1)
    exact = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    alike = ForceResiduals(model=exact, forces=laxity.forces)
    np.testing.assert_allclose(alike.residuals(exact.parameters.start), 0.0, atol=1e-9)
    theta = _theta(model)
    found = model.predict(theta)
    names = [f"{x}@{t}" for t in PROTOCOL.trials[1:] for x in NAMES]
    expected = [quantity_named(model, x).value(found) for x in names]
    measured = laxity.forces.values[1:].ravel()
    np.testing.assert_allclose(problem.residuals(theta), (expected - measured) / 5.0, rtol=1e-9)
    jacobian = problem.jacobian(theta)
    for i in range(theta.size):
        step = 1e-5 * model.parameters.prior_sd_in_own_units[i]
        move = step * np.eye(theta.size)[i]
        slope = (problem.residuals(theta + move) - problem.residuals(theta - move)) / (2.0 * step)
        bound = 1e-6 * (np.abs(jacobian[:, i]).max() + 1e-3 * np.abs(jacobian).max())
        np.testing.assert_allclose(slope, jacobian[:, i], rtol=0, atol=bound)


def test_the_deviance_is_a_sum_of_terms() -> None:
    laxity = _laxity()
    knee = ik.reference_knee()
    found = ik.fit(knee, laxity, more_starts=0, start={"ACL.stiffness_kN": 8.0})
    np.testing.assert_allclose(found.search.theta, knee_values(knee), atol=1e-4)
    terms = {x.name: x for x in found.evidence}
    assert terms[TABLE_TERM].n == 5 * PROTOCOL.n
    assert terms[FORCE_TERM].n == 2 * (PROTOCOL.n - 1)
    assert sum(x.deviance for x in found.evidence) == pytest.approx(
        2.0 * found.search.objective, abs=1e-9
    )


def knee_values(knee: ik.Knee) -> Array:
    """Its stiffnesses, then its reference strains."""
    stiffness = [x.stiffness_kN for x in knee.ligaments]
    return np.array([*stiffness, *(x.reference_strain_pct for x in knee.ligaments)])


@pytest.mark.slow
def test_forces_narrow_what_laxity_leaves_open() -> None:
    """Exactly as their information adds to that of the table."""
    laxity = _laxity()
    knee = ik.reference_knee()
    model = LaxityModel(knee=knee, protocol=PROTOCOL)
    theta = model.parameters.start
    residuals = LaxityResiduals(model=model, laxity=laxity, weighting="noise")
    whole = with_other_terms(residuals).jacobian(theta)
    n = 5 * PROTOCOL.n
    np.testing.assert_array_equal(whole[:n], residuals.jacobian(theta))
    without, beside = (np.sqrt(np.diag(np.linalg.inv(x.T @ x))) for x in (whole[:n], whole))
    assert np.all(beside < without)
    assert beside[0] < 0.65 * without[0]
    widths = []
    for x in (replace(laxity, forces=None), laxity):
        profile = ik.profile(knee, x, parameters=["ACL.stiffness_kN"]).parameters[
            "ACL.stiffness_kN"
        ]
        assert profile.lower is not None
        assert profile.upper is not None
        widths.append(profile.upper - profile.lower)
    assert widths[1] < 0.7 * widths[0]


def test_a_trial_without_equilibrium_leaves_its_forces_out() -> None:
    laxity = _laxity()
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    theta = model.parameters.vector({f"{x}.reference_strain_pct": -15.0 for x in ("ACL", "PCL")})
    residuals = LaxityResiduals(model=model, laxity=laxity, weighting="noise")
    assert np.isinf(with_other_terms(residuals).residuals(theta)).all()
    held = defined_everywhere(residuals)
    assert np.isfinite(held.residuals(theta)).all()
    assert np.isfinite(held.jacobian(theta)).all()
    lost = ~model.predict(theta).is_converged
    assert lost.any()
    forces = held.residuals(theta)[-2 * (PROTOCOL.n - 1) :].reshape(-1, 2)
    assert not forces[lost[1:]].any()


def test_what_has_no_force_is_refused() -> None:
    laxity = _laxity()
    cut = replace(laxity, protocol=replace(PROTOCOL, state=("cut: ACL",) * PROTOCOL.n))
    with pytest.raises(ValueError, match=r"\bACL\b.*\bcut\b"):
        ik.fit("reference", cut, noise=0.5)
    with pytest.raises(ValueError, match="XYZ"):
        ik.fit("reference", _with_names(laxity, ("XYZ.tension_N", "contact.medial_N")))
    with pytest.raises(ValueError, match="--noise"):
        ik.fit("reference", replace(laxity, sd=None))
    with pytest.raises(ValueError, match="heavy tails"):
        ik.fit("reference", laxity, likelihood="student")
    with pytest.raises(ValueError, match="below 0"):
        MeasuredForces(names=("ACL.tension_N",), values=np.array([[-4.1]]), sd=np.ones((1, 1)))


@pytest.mark.parametrize(
    ("state", "owner"),
    [("cut: MCL", "MCLa"), ("cut: MCL", "MCL"), ("cut: MCLa, MCLp", "MCL"), ("cut: MCLa", "MCLa")],
)
def test_the_force_of_what_is_cut_is_refused(state: str, owner: str) -> None:
    forces = MeasuredForces(
        names=(f"{owner}.tension_N",), values=np.ones((1, 1)), sd=np.ones((1, 1))
    )
    protocol = replace(PROTOCOL.select([0]), state=(state,))
    model = LaxityModel(knee=bundled_knee(), protocol=protocol)
    with pytest.raises(ValueError, match=f"force of {owner} .* cut"):
        ForceResiduals(model=model, forces=forces)


def test_a_group_that_keeps_a_bundle_has_a_force() -> None:
    forces = MeasuredForces(names=("MCL.tension_N",), values=np.ones((1, 1)), sd=np.ones((1, 1)))
    for state in ("cut: MCLa", "cut: MCL 50%"):
        model = LaxityModel(
            knee=bundled_knee(), protocol=replace(PROTOCOL.select([0]), state=(state,))
        )
        assert ForceResiduals(model=model, forces=forces).n == 1


def test_a_slack_ligament_may_read_a_little_below_zero(tmp_path: Path) -> None:
    """Refusing such readings would make the mean of those that are left too high."""
    laxity = _laxity(("ACL.tension_N",))
    assert laxity.forces is not None
    values = np.array(laxity.forces.values)
    values[1] = -19.0
    below = replace(laxity, forces=replace(laxity.forces, values=values))
    path = ik.write_laxity(below, tmp_path / "a.csv")
    again = ik.read_laxity(path).forces
    assert again is not None
    assert again.values[1, 0] == -19.0
    path.write_text(path.read_text().replace("-19.0,5.0", "-21.0,5.0"))
    with pytest.raises(ik.InputError, match=r"ACL_tension_N.*below 0"):
        ik.read_laxity(path)


def _with_names(laxity: ik.Laxity, names: tuple[str, ...]) -> ik.Laxity:
    assert laxity.forces is not None
    return replace(laxity, forces=replace(laxity.forces, names=names))
