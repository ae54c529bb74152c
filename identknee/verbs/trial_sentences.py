"""What a result says of the trials it rests on, and of where their equilibria were looked for."""

import numpy as np

from identknee.laxity.table import COORDINATES, Laxity
from identknee.mechanics.load_paths import NEAR
from identknee.mechanics.memory import ROTATION_SCALE
from identknee.model.laxity_model import LaxityModel
from identknee.model.measured_start import POSE_EVERY_DEG, known_poses
from identknee.runs.findings import Finding, Severity
from identknee.subject.knee import Knee

ABOUT_FALLBACK = (
    "Geometry is uncertain: a trial whose load path ends, or whose unloaded knee is loose, was "
    "looked for from its measured pose under its whole load."
)
ABOUT_NO_POSES = (
    "No trial has all five coordinates: equilibria were followed along paths from the scanned "
    "pose, not looked for at measured poses."
)


def trial_names(laxity: Laxity) -> tuple[str, ...]:
    """The trials with measured values."""
    return tuple(laxity.protocol.trials[i] for i in np.flatnonzero(laxity.is_measured.any(axis=1)))


def about_blanks(laxity: Laxity) -> tuple[str, ...]:
    """What was not measured at all: coordinates, and trials, which are only predicted."""
    columns = zip(COORDINATES, laxity.is_measured.T, strict=True)
    said = [f"{name} was not measured." for name, column in columns if not column.any()]
    blank = [x for x in laxity.protocol.trials if x not in trial_names(laxity)]
    if blank:
        are = "it is" if len(blank) == 1 else "they are"
        said.append(f"No value was measured in {', '.join(blank)}: {are} only predicted.")
    return tuple(said)


def about_inputs(knee: Knee, laxity: Laxity) -> tuple[str, ...]:
    """What a fit takes the knee and the table for: what is uncertain, blank, or left aside."""
    said = (knee.uncertainty.sentence, *about_blanks(laxity))
    if laxity.sd is None:
        return said
    stated = ~np.isnan(laxity.sd)
    if stated[laxity.is_measured].all():
        return said
    names = ", ".join(COORDINATES[i] for i in np.flatnonzero(np.any(stated, axis=0)))
    sentence = (
        f"Errors are stated of {names} only, so they were left aside: 1 mm counts as much as "
        "1 deg. State all, or give --noise."
    )
    return (*said, sentence)


def lost_findings(knee: Knee, laxity: Laxity, used: Laxity) -> tuple[Finding, ...]:
    """Which measured trials a result does not rest on."""
    measured, kept = trial_names(laxity), trial_names(used)
    lost = [x for x in measured if x not in kept]
    if not lost:
        return ()
    is_exact = knee.uncertainty.is_exact
    or_state = ", or state how well geometry is known with --uncertain" if is_exact else ""
    sentence = (
        f"The result rests on {len(kept)} of {len(measured)} measured trials: the model has no "
        f"equilibrium in {', '.join(lost)}. Look them up{or_state}."
    )
    return (Finding(severity=Severity.WARNING, sentence=sentence, where="trials"),)


def about_paths(model: LaxityModel) -> tuple[str, ...]:
    """Where equilibria were looked for, if not along paths from the scanned pose."""
    if model.fallback_poses is not None:
        has_poses = np.isfinite(model.fallback_poses).all(axis=1).any()
        return (ABOUT_FALLBACK if has_poses else ABOUT_NO_POSES,)
    if model.poses is None:
        return ()
    known = known_poses(model.knee, model.protocol)
    if known is not None and np.array_equal(model.poses, known):
        sentence = (
            "Equilibria were followed under growing loads from the poses that the fitted "
            "subject states for each flexion angle, not from measured ones."
        )
        return (sentence, *_about_extrapolation(model))
    sentence = (
        "Each trial has a flexion angle of its own, as a rig reads it: its equilibrium was looked "
        "for from its measured pose under its whole load, not along a path from the scanned pose, "
        f"and counts within {NEAR:.0f} mm and {np.degrees(NEAR / ROTATION_SCALE):.0f} deg of it."
    )
    return (sentence,)


def _about_extrapolation(model: LaxityModel) -> tuple[str, ...]:
    """Which trials lie beyond the flexion angles at which the knee states poses."""
    angles, known = model.protocol.flexion_deg, [x.flexion_deg for x in model.knee.poses]
    is_beyond = (angles < min(known) - POSE_EVERY_DEG) | (angles > max(known) + POSE_EVERY_DEG)
    if not is_beyond.any():
        return ()
    names = ", ".join(model.protocol.trials[i] for i in np.flatnonzero(is_beyond))
    sentence = (
        f"These poses lie at {min(known):.0f} to {max(known):.0f} deg of flexion: what is said of "
        f"trials far beyond ({names}) is extrapolated."
    )
    return (sentence,)


def about_offered(model: LaxityModel) -> tuple[str, ...]:
    """Where equilibria of trials that were not made are looked for, if not on paths from a scan."""
    if model.poses is None:
        return ()
    sentence = (
        "A trial that was not made has no measured pose: its equilibrium was followed under a "
        "growing load from the mean pose of the trials made, interpolated over flexion."
    )
    return (sentence,)
