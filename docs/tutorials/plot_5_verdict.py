"""
Reading a verdict
=================

A generator that shares no mechanics with the model makes data with something in the knee that the
model lacks. The diagnosis sees the data alone. Then the truth is revealed.
"""

import tempfile
from pathlib import Path

import identknee as ik
from identknee.report.diagnosis_figures import (
    added_variable_figure,
    misfit_figure,
    parameters_before_after_figure,
    scores_figure,
)

knee = ik.reference_knee()
case = ik.blind.blind_case(knee, seed=7, effect="anterolateral", signal=12.0)
diagnosis = ik.diagnose(knee, case.laxity)

# %%
# The verdict is one of five words, each with its sentence. ``NAMED``: the data speak against the
# model, and one known cause fits while no other does.

print(diagnosis.verdict.value)
print(diagnosis.sentence)
print(*diagnosis.reasons)

# %%
# **Where** the misfit is: each field of the map is one coordinate at one angle of flexion under
# loads in one direction.

print(diagnosis.misfit.sentence)
figure = misfit_figure(diagnosis.misfit.map, diagnosis.misfit.sentence)

# %%
# **What** could explain it: the scores of all effects of the library, beside the model without
# causes, and then beside the explanation, where no score should be left.

figure = scores_figure(diagnosis.steps)

# %%
# **How much**: the amplitude with its interval. If the cause is right, the points of this figure
# lie along the line.

for cause in diagnosis.causes:
    low, high = cause.ci95
    print(f"{cause.name}: {cause.amplitude:.2f} {cause.unit}, 95 % {low:.2f} to {high:.2f}")
figure = added_variable_figure(diagnosis.added_variable)

# %%
# **Rivals**: other causes, with the evidence for them relative to the best one, and how far they
# stay from the data that the best one predicts.

for rival in diagnosis.rivals:
    names = " + ".join(rival.causes) or "none"
    print(f"{names:24} distance {rival.distance or 0.0:5.1f}  {rival.state.value}")

# %%
# **What it does to the parameters** is why this matters: without its cause the misfit is absorbed
# by ligaments that have nothing to do with it. Crosses mark the truth, which is known only in a
# blind case.

figure = parameters_before_after_figure(diagnosis, case.truth.theta)

# %%
# What to keep: the page, with every figure above and the numbers behind them.

page = ik.report(diagnosis, Path(tempfile.mkdtemp()) / "report.html")
print(page.name)

# %%
# Not every verdict is ``NAMED``. ``ADEQUATE`` says that the data show nothing wrong, and which
# causes they could not have shown; ``AMBIGUOUS`` names the trials that would tell its rivals apart;
# ``UNEXPLAINED`` gives a line of force that is missing; ``NOT_TESTABLE`` says why.
#
# On the command line: ``identknee blind``, ``identknee diagnose``, ``identknee reveal``.
