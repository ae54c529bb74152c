"""Tolerances that several parts of estimation share, and what each is a share of."""

# Singular values of a Jacobian below this share of the largest are rounding, not information.
RANK_TOLERANCE = 1e-10
# The same of the triangle that a step is made from: its columns are in conditional standard
# deviations, so that rounding alone is left, and a direction known to 1e10 of them still counts.
STEP_RANK_TOLERANCE = 1e-12
# The same where a quantity is called unseen by the data: in conditional standard deviations, with
# room for what the solver's own tolerance leaves in the derivatives.
UNSEEN_TOLERANCE = 1e-9
# The same share of the largest eigenvalue of the information, a singular value squared.
EIGENVALUE_TOLERANCE = 1e-10
# Share of the deviance that an impossible step may promise at a minimum on a kink, and how much of
# it where there are nuisances, whose priors make it one in units of the noise: a tenth of a
# standard deviation. Insertions that may be elsewhere lead onto kinks as a rule.
KINK_SHARE, KINK_DEVIANCE = 1e-6, 0.01
