"""Trials made and offered: one that is both is the same in both."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnoses import SD, short_trials

from identknee.diagnosis import advice
from identknee.diagnosis.advice import AdviceCandidates, WhitenedRows
from identknee.diagnosis.fitting import base_model, best_fit_from, stated_noise
from identknee.diagnosis.isolability import AdvisedTrials
from identknee.laxity.protocol import candidate_trials, load_protocol
from identknee.laxity.table import Laxity, relative_to_unloaded
from identknee.model.effects.tissues import toe_strain
from identknee.model.residuals import nuisance_changes
from identknee.subject.knee import Knee


@pytest.mark.parametrize("zero", ["absolute", "unloaded"])
def test_a_trial_made_and_offered_has_the_same_rows(reference: Knee, zero: str) -> None:
    model = base_model(reference, short_trials())
    theta = model.parameters.center
    exact = model.predict(theta, derivatives=False)
    sd = np.full(exact.coordinates.shape, SD)
    laxity = Laxity(protocol=model.protocol, coordinates=exact.coordinates, sd=sd)
    if zero == "unloaded":
        laxity = relative_to_unloaded(laxity)
        laxity = Laxity(
            protocol=laxity.protocol, coordinates=laxity.coordinates, sd=sd, zero=laxity.zero
        )
    fitted = best_fit_from(model, laxity, stated_noise(laxity), [theta], most_steps=1)
    candidates = candidate_trials(laxity.protocol, flexion_deg=[30.0])
    offer = AdviceCandidates(laxity=laxity, candidates=candidates)
    _, slopes = offer.predict(fitted.model, fitted.theta)
    for rows in (slopes, offer.nuisances(fitted)):
        n = laxity.n
        again = rows.offered[:n]
        assert candidates.trials[:n] == laxity.protocol.trials
        assert rows.offered.shape[:2] == (candidates.n, 5)
        made = np.zeros((n, 5, rows.made.shape[1]))
        made[laxity.is_measured] = rows.made
        np.testing.assert_allclose(
            again[laxity.is_measured], made[laxity.is_measured], rtol=1e-6, atol=1e-8
        )


def test_an_effect_of_the_model_is_not_a_nuisance_too(reference: Knee) -> None:
    plain = base_model(reference, short_trials())
    extended = plain.with_effects([*plain.effects, toe_strain()])
    one, spreads = nuisance_changes(plain, plain.parameters.center)
    other, fewer = nuisance_changes(extended, extended.parameters.center)
    assert len(fewer) == len(spreads) - 1
    np.testing.assert_allclose(other, one[:, :, :-1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("chosen", [(), (0,)])
def test_nothing_is_advised_where_no_offered_trial_has_an_equilibrium(
    chosen: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    protocol = load_protocol("drawer")
    laxity = Laxity(protocol=protocol, coordinates=np.zeros((protocol.n, 5)))
    distances = np.ones((1 + len(chosen), 1)) if chosen else np.full((1, 1), np.nan)
    found = AdvisedTrials(chosen=chosen, distances=distances, single=distances[:1])
    rows = WhitenedRows(made=np.zeros((1, 1)), offered=np.zeros((1, 1, 1)))
    monkeypatch.setattr(advice, "_table", lambda *_: (rows, []))
    monkeypatch.setattr(advice, "measured_errors", lambda *_: {})
    monkeypatch.setattr(
        AdviceCandidates, "advise", lambda *_, **__: (protocol, found, np.zeros((0, 1)))
    )
    fitted = SimpleNamespace(model=SimpleNamespace(poses=None))
    best: Any = SimpleNamespace(names=("a",), fitted=fitted, n_base=1)
    rival: Any = SimpleNamespace(refit=SimpleNamespace(names=("b",)))
    assert (advice.advise(best, [rival], laxity) is None) == (not chosen)
