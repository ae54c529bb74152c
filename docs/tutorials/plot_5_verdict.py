"""
Reading a verdict
=================

Data are made with something in the knee that the model lacks, by a generator that shares no
mechanics with it. A diagnosis sees the data alone. Then the truth is opened.
"""

import identknee as ik
from identknee.diagnosis.explanations.causes import causes_of
from identknee.report.diagnosis_figures import (
    added_variable_figure,
    misfit_figure,
    parameters_before_after_figure,
    scores_figure,
)

knee = ik.reference_knee()
case = ik.blind_case(knee, seed=7, effect="anterolateral", signal=12.0)
diagnosis = ik.diagnose(knee, case.laxity)

# %%
# The verdict is one of five words, each with its sentence. ``NAMED``: the data speak against the
# model, and one known cause fits while no other does.

conclusion = diagnosis.conclusion
print(conclusion.verdict.value)
print(conclusion.verdict.sentence)
print(f"Noise alone would leave a misfit as clear in {100 * conclusion.p_value:.2g} % of cases.")

# %%
# **Where** the misfit is: each field of the map is one coordinate at one angle of flexion under
# loads of one direction.

print(diagnosis.localisation.sentence)
figure = misfit_figure(diagnosis.localisation)

# %%
# **What** could explain it: the scores of all effects of the library, beside the model without
# causes and then beside the explanation, where none should be left.

figure = scores_figure(diagnosis)

# %%
# **How much**: the amplitude with its interval. If the cause is right, the points of this figure
# lie along the line.

explanation = diagnosis.explanation
for cause in causes_of(explanation):
    size, (low, high) = cause.amplitude, cause.amplitude.ci95
    print(f"{cause.name}: {size.value:.2f} {size.unit}, 95 % {low:.2f} to {high:.2f}")
figure = added_variable_figure(diagnosis)

# %%
# **Rivals**: other causes, with the evidence for them against the best, and how far they would
# stay from the data that the best one expects.

for rival in diagnosis.attribution.rivals:
    names = " + ".join(rival.refit.names) or "none"
    print(f"{names:24} distance {rival.distance:5.1f}  excluded: {rival.is_excluded}")

# %%
# **What it does to the parameters** is the reason to look at all: without its cause the misfit is
# taken up by ligaments that have nothing to do with it. Crosses are the truth, which only a blind
# case knows.

figure = parameters_before_after_figure(diagnosis, case.truth.theta)

# %%
# Not every verdict is ``NAMED``. ``ADEQUATE`` says that the data show nothing wrong, and which
# causes they could not have shown; ``AMBIGUOUS`` names the trials that would tell its rivals apart;
# ``UNEXPLAINED`` gives a line of force that is missing; ``NOT_TESTABLE`` says why.
#
# On the command line: ``identknee blind``, ``identknee diagnose``, ``identknee reveal``.
