"""How far numbers may differ, each with its reason."""

# A few dozen roundings of numbers of their own size.
CLOSED_FORM = 1e-12
# Sums of hundreds of terms that partly cancel, added in another order. The bar is 1e-8.
DERIVATIVE = 1e-11
# Central differences of equilibria solved again: truncation and rounding balance near this.
DIFFERENCE = 1e-5
# Largest gradient left at an equilibrium [N], moments divided by 40 mm.
RESIDUAL_N = 1e-6
# Poses solved along different ways [mm, angles times 40 mm], and the stability margin from which
# on that is promised [N/mm].
SAME_POSE = 1e-9
SAME_MARGIN = 0.5
# Poses of the throw-away solver that calibrated the reference knee, kept to 4 decimals.
PUBLISHED_MM_OR_DEG = 0.1
# Numbers recorded from an earlier state of this program: rounding may differ, nothing else.
PINNED = 1e-6
# An observed order of convergence over the theoretical one.
ORDER = 0.3
