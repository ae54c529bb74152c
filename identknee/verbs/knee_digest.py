"""The numbers of a knee as one digest, by which subjects are told apart."""

from identknee.runs.files import digest
from identknee.subject.knee import Knee
from identknee.subject.uncertainty import EXACTLY


def knee_digest(knee: Knee) -> str:
    """SHA-256 of all numbers of a knee, and of what it states to be uncertain."""
    parts = [knee.side.encode()]
    for x in knee.ligaments:
        numbers = (*x.femur.tolist(), *x.tibia.tolist(), x.stiffness_kN, x.reference_strain_pct)
        parts.append(f"{x.name} {numbers}".encode())
    for effect in knee.effects:
        ends = [(femur.tolist(), tibia.tolist()) for femur, tibia in effect.lines]
        spread = (effect.stiffness_sd_kN, effect.site_sd_mm)
        parts.append(f"{effect.name} {dict(effect.values)} {effect.fixed} {ends} {spread}".encode())
    stated = (knee.uncertainty, sorted(knee.priors.items()), sorted(knee.bounds.items()))
    if stated != (EXACTLY, [], []):
        parts.append(repr(stated).encode())
    known = [(x.flexion_deg, x.coordinates.tolist()) for x in knee.poses]
    further = (knee.groups, known, sorted(knee.fitted.items()))
    if further != ((), [], []):
        parts.append(repr(further).encode())
    if knee.contact_rounding_mm:
        parts.append(f"contact rounding {knee.contact_rounding_mm}".encode())
    for surface in (knee.femur, *knee.tibia):
        parts += [surface.vertices.tobytes(), surface.faces.tobytes()]
    for frame in (knee.femur_frame, knee.tibia_frame):
        parts += [frame.origin.tobytes(), frame.axes.tobytes()]
    return digest(b"".join(parts))
