"""Line ligaments in plain numpy: tensions, generalised force and stiffness of all at one pose."""

import numpy as np

from identknee.mechanics.equilibria import TRANSITION_STRAIN, Lines
from identknee.mechanics.placement import Placement
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared


@declared
class LigamentWrench:
    """What the ligaments do to the tibia at one pose."""

    force: Array = array(
        "Generalised force on varus, internal rotation, x, y and z", "freedom", unit="N mm or N"
    )
    stiffness: Array = array(
        "Minus its derivative by the pose, the Hessian of the ligaments' energy",
        *("freedom", "freedom"),
        unit="N mm, N or N/mm",
    )
    tensions: Array = array("Tensions", "ligament", unit="N")


def line_tensions(
    strain: Array, stiffness: Array, transition: Array | float = TRANSITION_STRAIN
) -> tuple[Array, Array]:
    """Tension [N] at `strain` of lines of `stiffness` [N], and its derivative by strain [N].

    Where `transition` is negative the line is a spring, which pushes as well as it pulls.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883

    Examples
    --------
    >>> tension, slope = line_tensions(np.array([-0.1, 0.03, 0.06, 0.1]), np.full(4, 1000.0))
    >>> tension
    array([ 0. ,  7.5, 30. , 70. ])
    """
    width = np.abs(transition)
    stretched = np.maximum(strain, 0.0)
    toe = stretched < 2.0 * width
    tension = np.where(toe, stretched**2 / (4.0 * width), stretched - width)
    slope = np.where(toe, stretched / (2.0 * width), 1.0)
    is_spring = np.asarray(transition) < 0.0
    tension, slope = np.where(is_spring, strain, tension), np.where(is_spring, 1.0, slope)
    return stiffness * tension, stiffness * slope


def ligament_wrench(
    placement: Placement, lines: Lines, stiffness: Array, reference_strain: Array
) -> LigamentWrench:
    """Tensions, generalised force and stiffness of the ligaments at a placement of the tibia.

    Parameters
    ----------
    placement
        Where the tibia stands.
    lines
        Insertions and reference lengths of the m ligaments.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    offset = placement.to_femur(lines.tibial) - lines.femoral
    length = np.linalg.norm(offset, axis=1)
    direction = offset / length[:, None]
    slack_length = lines.reference_length / (1.0 + reference_strain)
    tension, slope = line_tensions(length / slack_length - 1.0, stiffness)
    jacobian = placement.jacobian(lines.tibial)
    lengthening = np.einsum("nai,ni->na", jacobian, direction)
    turning = tension / length
    hessian = (
        np.einsum("n,na,nb->ab", slope / slack_length - turning, lengthening, lengthening)
        + np.einsum("n,nai,nbi->ab", turning, jacobian, jacobian)
        + placement.bending(lines.tibial, tension[:, None] * direction)
    )
    return LigamentWrench(force=-tension @ lengthening, stiffness=hessian, tensions=tension)
