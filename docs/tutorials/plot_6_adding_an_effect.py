"""
Adding an effect
================

An effect is a physical cause whose amplitudes are zero where it does not act. This one is not in
the library: a goniometer that is mounted askew reads a share of varus as internal rotation.
"""

import tempfile
from pathlib import Path

import numpy as np

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.laxity.table import COORDINATES
from identknee.model.effects.effect import amplitudes
from identknee.report.diagnosis_figures import scores_figure

VARUS, INTERNAL = COORDINATES.index("varus_deg"), COORDINATES.index("internal_deg")

# %%
# Three names make an effect: what it is called, its amplitudes (with unit, prior and plausible
# range) and either ``change``, for what happens in the knee, or ``observe``, for what is read.


class Crosstalk:
    """A share of varus that is read as internal rotation [-]."""

    name = "crosstalk"
    parameters = amplitudes("crosstalk", ["share"], [0.1], upper=[0.5])

    def observe(self, coordinates, values, _tests):
        """The coordinates read, shape ``(n, 5)`` [mm, deg]."""
        read = np.array(coordinates)
        read[:, INTERNAL] += values[0] * read[:, VARUS]
        return read


# %%
# A model extended by it is a model like any other. The amplitude is one more parameter, and its
# derivatives need no code.

knee = ik.reference_knee()
protocol = ik.load_protocol("seed63")
extended = ik.LaxityModel(knee=knee, protocol=protocol, effects=(Crosstalk(),))
print(extended.parameters.names[-1])
truth = extended.parameters.vector({"crosstalk.share": 0.2})
laxity = ik.add_noise(extended.simulate(truth), sd_mm=0.3, sd_deg=0.3, seed=3)

# %%
# Does a fit find it? Among all the parameters this one is well determined:

problem = ik.LaxityResiduals(model=extended, laxity=laxity, weighting="noise")
fitted = fit(problem, problem.parameters.center)
(profile,) = ik.profile_parameters(problem, fitted.theta, ["crosstalk.share"])
print(f"{profile.optimum_value:.3f}, {profile.lower:.3f} to {profile.upper:.3f}")

# %%
# And would a diagnosis name it among other causes? Some from the library are offered too.

others = ["moment_gain_IE", "moment_offset", "axis_misalignment", "rig_compliance_IE"]
candidates = [Crosstalk(), *(ik.effect_named(knee, name) for name in others)]
diagnosis = ik.diagnose(knee, laxity, effects=candidates)
print(diagnosis.verdict.value, diagnosis.cause_names)

# %%
# The scores of all candidates, before and after the cause is in the model:

figure = scores_figure(diagnosis.steps)

# %%
# What to keep: the figure, and the table of all candidates.

folder = Path(tempfile.mkdtemp())
figure.savefig(folder / "scores.svg")
diagnosis.to_dataframe().to_csv(folder / "diagnosis.csv", index=False)

# %%
# To have it in the library for everyone takes a file, a row of facts and a line: see
# :doc:`/contributing`. Remember that each new effect is one more possible wrong name for the
# others.
