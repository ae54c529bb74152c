"""The reference knee: an analytic subject made of closed formulas, meshed at any edge length."""

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from identknee.runs.arrays import Array
from identknee.subject.condyle import Condyle
from identknee.subject.examples import REFERENCE
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament
from identknee.subject.plateau import Plateau
from identknee.subject.surface import joined

EDGE_MM = 1.2
FINEST_FEMUR_EDGE_MM = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class CondyleDistance:
    """Signed distance to a femur that consists of condyles; call it with points ``(n, 3)`` [mm].

    Attributes
    ----------
    condyles
        Each of them.
    """

    condyles: tuple[Condyle, ...]

    def __call__(self, points: Array) -> Array:
        """Signed distance of each point [mm], negative inside, shape ``(n,)``."""
        distances = [x.distance(points) for x in self.condyles]
        nearest: Array = np.min(distances, axis=0)
        return nearest


def reference_knee(edge_mm: float = EDGE_MM, *, femur_edge_mm: float | None = None) -> Knee:
    """The reference knee, a right knee whose two frames coincide in extension.

    Its surfaces are closed formulas fitted to real cartilage, its insertions are calibrated to
    published laxity, and its ligament parameters are the reference values of the initial-guess
    paper. It is a plausible default, not a measured subject.

    Parameters
    ----------
    edge_mm
        Typical edge of the tibial triangles [mm]; 1.2 gives 1,550 vertices.
    femur_edge_mm
        The same for the femur; the smaller of `edge_mm` and 0.8 if not given.

    Raises
    ------
    ValueError
        If an edge is not within 0.2 to 10 mm.

    Examples
    --------
    >>> knee = reference_knee()
    >>> sum(len(x.vertices) for x in knee.tibia)
    1550
    """
    if femur_edge_mm is None:
        femur_edge_mm = min(edge_mm, FINEST_FEMUR_EDGE_MM)
    for edge in (edge_mm, femur_edge_mm):
        if not 0.2 <= edge <= 10.0:
            raise ValueError(f"the edge of the triangles must be within 0.2 to 10 mm, got {edge:g}")
    numbers = _numbers()
    condyles = tuple(Condyle(**_values(x)) for x in numbers["femur"].values())
    plateaus = [Plateau(**_values(numbers["tibia"][side])) for side in ("medial", "lateral")]
    frame = Frame(origin=np.zeros(3), axes=np.eye(3))
    return Knee(
        name=REFERENCE,
        side="right",
        description="Analytic reference knee: canal-surface condyles, height-field plateaus.",
        femur=joined(*(x.mesh(femur_edge_mm) for x in condyles)),
        tibia=tuple(x.mesh(edge_mm) for x in plateaus),
        ligaments=tuple(
            Ligament(
                name=name,
                femur=entry["femur"]["value"],
                tibia=entry["tibia"]["value"],
                stiffness_kN=entry["stiffness"]["value"],
                reference_strain_pct=entry["reference_strain"]["value"],
            )
            for name, entry in numbers["ligaments"].items()
        ),
        femur_frame=frame,
        tibia_frame=frame,
        femur_distance=CondyleDistance(condyles=condyles),
    )


def _numbers() -> dict[str, Any]:
    text = resources.files("identknee.subject").joinpath("reference_knee.toml").read_text("utf-8")
    return tomllib.loads(text)


def _values(table: dict[str, Any]) -> dict[str, float]:
    """The values of a table whose entries also tell unit and source."""
    return {name: entry["value"] for name, entry in table.items()}
