"""The force of a line ligament. Another law is another function of this form."""

from identknee.mechanics.compiled import compiled


@compiled
def tension(strain, stiffness, transition):
    """Force of a line ligament, its slope with strain and its integral over strain.

    Equation 3 of the paper: quadratic up to twice the transition strain, linear beyond.
    """
    if strain <= 0.0:
        return 0.0, 0.0, 0.0
    if strain <= 2.0 * transition:
        slope = stiffness * strain / (2.0 * transition)
        return 0.5 * slope * strain, slope, slope * strain * strain / 6.0
    over = strain - transition
    return (
        stiffness * over,
        stiffness,
        stiffness * (0.5 * over * over + transition * transition / 6.0),
    )
