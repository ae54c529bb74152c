"""What a knee carries in every trial: the colours and the numbers are those of the model."""

from dataclasses import replace

import numpy as np
import pytest
from bundled_knee import bundled_knee
from figure_checks import faults
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from report_folders import few_trials

import identknee as ik
from identknee.model.contact_loads import contact_values, meniscus_values
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.report.figures import FIT
from identknee.report.page.load_figures import (
    FAILED,
    Loads,
    forces_chart,
    knee_loads_figure,
    loads_of,
    strengths_of,
)
from identknee.report.page.viewer import KneeScene, model_scene
from identknee.report.presenter import Range, Source
from identknee.runs.record import Outcome


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=bundled_knee(), protocol=few_trials())


@pytest.fixture(scope="module")
def scene(model: LaxityModel) -> KneeScene:
    return model_scene(model, model.parameters.center)


@pytest.fixture(scope="module")
def loads(scene: KneeScene) -> Loads:
    return loads_of(scene, strengths_of(scene))


def test_bundles_that_fail_together_carry_together(
    model: LaxityModel, scene: KneeScene, loads: Loads
) -> None:
    prediction = model.predict(model.parameters.center, derivatives=False)
    tensions = tensions_of(model, prediction)
    assert scene.names == ("ACL", "PCL", "LCL", "MCLa", "MCLp")
    assert loads.names == ("ACL", "PCL", "LCL", "MCL")
    np.testing.assert_allclose(loads.forces[:, :3], tensions[:, :3])
    np.testing.assert_allclose(loads.forces[:, 3], tensions[:, 3:].sum(axis=1))
    np.testing.assert_allclose(loads.shares[:, 3], tensions[:, 3:].sum(axis=1) / 557.0)
    np.testing.assert_array_equal(loads.contact, contact_values(prediction)[:, :, 0])


def _panels(figure: Figure) -> dict[str, list[str]]:
    """By the kind of load of a panel, the colours of its loaded ligaments."""
    return {
        x.get_title(): [
            to_hex(np.asarray(y.get_edgecolor())[0])
            for y in x.collections
            if isinstance(y, LineCollection)
        ][1::2]
        for x in figure.axes
        if x.get_title()
    }


def test_ligaments_are_coloured_by_their_share(
    model: LaxityModel, scene: KneeScene, loads: Loads
) -> None:
    figure = knee_loads_figure(scene, model.protocol, loads)
    assert faults(figure) == []
    assert set(_panels(figure)) == {
        *("external moment", "internal moment", "valgus moment", "varus moment", "unloaded")
    }
    # Where nothing is near its strength nothing has the colour of what fails, and the other way.
    strong, weak = (replace(loads, strengths=k * loads.strengths) for k in (10.0, 0.01))
    for own, is_failed in ((strong, False), (weak, True)):
        drawn = knee_loads_figure(scene, model.protocol, own)
        assert (FAILED in {y for x in _panels(drawn).values() for y in x}) is is_failed
        trial = int(np.nanargmax(own.shares.max(axis=1)))
        most = int(np.nanargmax(own.shares[trial]))
        words = f"{own.names[most]} {100 * own.shares[trial, most]:.0f} %"
        assert words in [y.get_text() for x in drawn.axes for y in x.texts]


def test_a_lost_trial_is_said_to_be_lost(
    model: LaxityModel, scene: KneeScene, loads: Loads
) -> None:
    first = replace(scene.trials[0], outcome=Outcome.FOLD)
    lost = replace(scene, trials=(first, *scene.trials[1:]))
    figure = knee_loads_figure(lost, model.protocol, loads)
    said = [y.get_text() for x in figure.axes for y in x.texts]
    assert said.count("no\nequilibrium") == 1


def test_the_chart_has_every_force_its_interval_and_its_limit(
    model: LaxityModel, loads: Loads
) -> None:
    trials = model.protocol.trials
    known = Range(source=Source.PROFILE, low=3.0, high=9.0, value=5.0, status="known")
    open_end = replace(known, high=None)
    ranges = {f"MCL.tension_N@{trials[1]}": known, f"contact.medial_N@{trials[2]}": open_end}
    figure = forces_chart(trials, loads, ranges)
    assert faults(figure, trials) == []
    panels = {x.get_title(): x for x in figure.axes}
    assert list(panels) == [*loads.names, "medial contact", "lateral contact"]
    for k, name in enumerate(loads.names):
        (dots,) = [x for x in panels[name].lines if x.get_marker() == "o"]
        np.testing.assert_array_equal(dots.get_xdata(), loads.forces[:, k])
        (limit,) = [x for x in panels[name].lines if np.ptp(np.asarray(x.get_xdata())) == 0.0]
        assert np.asarray(limit.get_xdata())[0] == loads.strengths[k]
    bars = {
        name: [x for x in axes.lines if x.get_color() == FIT and x.get_marker() == "None"]
        for name, axes in panels.items()
    }
    assert [len(x) for x in bars.values()] == [0, 0, 0, 1, 1, 0]
    np.testing.assert_array_equal(bars["MCL"][0].get_xydata(), [[3.0, 1.0], [9.0, 1.0]])
    medial = panels["medial contact"]
    assert np.asarray(bars["medial contact"][0].get_xdata())[1] == medial.get_xlim()[1]
    assert [x.get_text() for x in figure.legends[0].get_texts()][1] == "95 % interval"
    plain = forces_chart(trials, loads)
    assert "95 % interval" not in [x.get_text() for x in plain.legends[0].get_texts()]


def test_the_chart_has_the_forces_of_menisci_where_a_knee_has_them() -> None:
    model = LaxityModel(knee=ik.subject.with_menisci(bundled_knee()), protocol=few_trials())
    theta, trials = np.array(model.parameters.start), model.protocol.trials
    scene = model_scene(model, theta)
    own = loads_of(scene, strengths_of(scene))
    wanted = meniscus_values(model.predict(theta, derivatives=False))[:, :, 0]
    np.testing.assert_array_equal(own.menisci, wanted)
    known = Range(source=Source.PROFILE, low=3.0, high=9.0, value=5.0, status="known")
    figure = forces_chart(trials, own, {f"meniscus.lateral_N@{trials[1]}": known})
    assert faults(figure, trials) == []
    panels = {x.get_title(): x for x in figure.axes}
    assert list(panels)[-2:] == ["medial meniscus", "lateral meniscus"]
    for k, side in enumerate(("medial", "lateral")):
        lines = panels[f"{side} meniscus"].lines
        (dots,) = [x for x in lines if x.get_marker() == "o"]
        np.testing.assert_array_equal(dots.get_xdata(), wanted[:, k])
        assert len([x for x in lines if x.get_color() == FIT and x.get_marker() == "None"]) == k
