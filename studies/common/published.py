"""Published laxity and model errors, as printed, with the study that each number comes from.

All numbers are from "Influence of the Initial Guess on the Estimation of Knee Ligament Parameters
via Optimization Procedures" ("the paper"), which cites the studies named; those were not read here.
The zero pose of each study is its own and is not given.
"""

from dataclasses import dataclass

import numpy as np

from identknee.laxity.protocol import LOADS, SAME_ANGLE_DEG, trial_name
from identknee.laxity.table import COORDINATES, Laxity, relative_to_unloaded
from identknee.runs.declare import Array

PAPER = (
    "Influence of the Initial Guess on the Estimation of Knee Ligament Parameters via "
    "Optimization Procedures"
)

# Load as printed: its column, the sign there, and the coordinate that answers to it.
_MEANING = {
    "anterior force": ("anterior_force_N", 1, "anterior_drawer_mm"),
    "posterior force": ("anterior_force_N", -1, "anterior_drawer_mm"),
    "internal moment": ("internal_moment_Nm", 1, "internal_deg"),
    "external moment": ("internal_moment_Nm", -1, "internal_deg"),
    "varus moment": ("varus_moment_Nm", 1, "varus_deg"),
    "valgus moment": ("varus_moment_Nm", -1, "varus_deg"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedLaxity:
    """One row of the paper's Table 2: the response to one load.

    Attributes
    ----------
    load
        As printed, for example ``"posterior force"``.
    magnitude
        Size of the load, as printed, > 0 [N or N·m].
    flexion_deg
        Flexion angle [deg].
    quantity
        What was measured, positive the way the load pushes, for example
        ``"posterior translation"`` [mm or deg].
    mean, sd
        Over the specimens of the study [mm or deg].
    paper_model
        What the paper's own model gave [mm or deg].
    study
        Where the measurement comes from.
    """

    load: str
    magnitude: float
    flexion_deg: float
    quantity: str
    mean: float
    sd: float
    paper_model: float
    study: str

    @property
    def column(self) -> str:
        """Column of the load in a laxity table, for example ``"anterior_force_N"``."""
        return _MEANING[self.load][0]

    @property
    def value(self) -> float:
        """Load in that column [N or N·m], negative for posterior, external and valgus."""
        return self.sign * self.magnitude

    @property
    def sign(self) -> int:
        """1 where `quantity` and its coordinate grow together, -1 where they do not."""
        return _MEANING[self.load][1]

    @property
    def coordinate(self) -> str:
        """Coordinate that answers to the load, for example ``"internal_deg"``."""
        return _MEANING[self.load][2]

    @property
    def unit(self) -> str:
        """Unit of `mean`, `sd` and `paper_model`."""
        return self.coordinate.rsplit("_", 1)[1]

    @property
    def trial(self) -> str:
        """Name of the trial in the protocol ``table2``."""
        return trial_name(self.flexion_deg, self.loads)

    @property
    def loads(self) -> tuple[float, ...]:
        """All loads of the trial, in the order of `LOADS`."""
        return tuple(self.value if column == self.column else 0.0 for column in LOADS)


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedError:
    """One row of the paper's Table 5: root-mean-square difference of a model and measurements.

    Each quantity is a pair of mean and standard deviation over specimens, the latter None where
    not printed; the pair is None where the study has none.

    Attributes
    ----------
    study
        Where it comes from.
    flexion_deg
        Flexion angle [deg], None where the row is over several.
    internal_deg, varus_deg
        Errors of internal and varus rotation [deg].
    anterior_mm
        Error of anterior translation [mm].
    """

    study: str
    flexion_deg: float | None
    internal_deg: tuple[float, float | None] | None
    varus_deg: tuple[float, float | None] | None
    anterior_mm: tuple[float, float | None] | None


def table2_laxity(laxity: Laxity) -> Array:
    """Response to each load of `TABLE2`, positive the way it pushes [mm or deg], shape ``(13,)``.

    Parameters
    ----------
    laxity
        With these loads and the unloaded trial of each angle, such as the protocol ``table2``
        simulated. NaN in the result where a coordinate is not measured.

    Raises
    ------
    ValueError
        If a trial is missing.
    """
    relative = relative_to_unloaded(laxity)
    protocol = laxity.protocol
    found = []
    for row in TABLE2:
        same_load = (protocol.loads == np.array(row.loads)).all(axis=1)
        same_angle = np.abs(protocol.flexion_deg - row.flexion_deg) <= SAME_ANGLE_DEG
        rows = np.flatnonzero(same_load & same_angle)
        if not rows.size:
            raise ValueError(
                f"{protocol.name!r} has no trial with {row.load} {row.magnitude:g} at "
                f"{row.flexion_deg:g} deg. Simulate the protocol table2."
            )
        found.append(
            row.sign * relative.coordinates[rows, COORDINATES.index(row.coordinate)].mean()
        )
    return np.array(found)


def _row(
    load: str, setting: tuple[float, float], mean: float, sd: float, model: float, study: str
) -> PublishedLaxity:
    direction, kind = load.split()
    quantity = f"{direction} {'translation' if kind == 'force' else 'rotation'}"
    magnitude, flexion = setting
    return PublishedLaxity(
        load=load,
        magnitude=magnitude,
        flexion_deg=flexion,
        quantity=quantity,
        mean=mean,
        sd=sd,
        paper_model=model,
        study=study,
    )


TABLE2 = (
    _row("anterior force", (134, 30), 5.6, 3.1, 5.7, "Senioris 2017"),
    _row("posterior force", (100, 30), 6.1, 2.5, 9.4, "Nau 2005"),
    _row("internal moment", (5, 30), 21.0, 2.8, 23.0, "Liu 2014"),
    _row("internal moment", (5, 60), 20.8, 4.6, 25.0, "Liu 2014"),
    _row("external moment", (5, 20), 12.4, 3.6, 10.4, "Shultz 2010"),
    _row("external moment", (5, 30), 17.7, 2.7, 7.0, "Liu 2014"),
    _row("external moment", (5, 60), 18.7, 4.2, 10.0, "Liu 2014"),
    _row("varus moment", (10, 0), 2.5, 1.1, 1.9, "Liu 2014"),
    _row("varus moment", (10, 30), 5.4, 1.7, 5.4, "Liu 2014"),
    _row("varus moment", (10, 60), 6.3, 1.6, 7.0, "Liu 2014"),
    _row("valgus moment", (8, 0), 2.1, 0.4, -0.2, "Wierer 2021"),
    _row("valgus moment", (8, 30), 3.7, 0.9, 1.3, "Wierer 2021"),
    _row("valgus moment", (8, 60), 4.4, 1.2, 2.4, "Wierer 2021"),
)
"""The paper's Table 2: measured laxity, and its own model beside it."""


def _error(
    study: str,
    flexion: float | None,
    internal: tuple[float, float | None] | None = None,
    varus: tuple[float, float | None] | None = None,
    anterior: tuple[float, float | None] | None = None,
) -> PublishedError:
    return PublishedError(
        study=study,
        flexion_deg=flexion,
        internal_deg=internal,
        varus_deg=varus,
        anterior_mm=anterior,
    )


TABLE5 = (
    _error("Baldwin (internal, varus)", None, (2.6, 0.3), (0.6, 0.4)),
    _error("Baldwin (external, valgus)", None, (2.2, 0.9), (1.4, 1.0)),
    _error("Ewing", 0, (3.2, 2.2), (1.7, 1.3)),
    _error("Ewing", 20, None, (4.0, 2.7)),
    _error("Ewing", 90, None, (4.3, 2.9)),
    _error("Harris", 0, (4.9, 0.7), (1.2, 0.4), (2.0, 1.2)),
    _error("Harris", 15, (5.8, 1.9), (1.8, 0.5), (2.2, 1.0)),
    _error("Harris", 30, (3.5, 1.1), (1.5, 0.5), (1.5, 0.7)),
    _error("Harris", 45, (2.1, 0.7), (1.2, 0.6), (1.4, 0.6)),
    _error("Harris", 60, (4.1, 1.4), (1.7, 1.2), (1.8, 0.8)),
    _error("the paper, IG4", 0, (0.9, None), (0.6, None), (1.0, None)),
    _error("the paper, IG4", 30, (0.7, None), (0.5, None), (0.7, None)),
    _error("the paper, IG4", 60, (0.4, None), (0.5, None), (0.5, None)),
)
"""The paper's Table 5. Its IG4 rows are printed in the columns headed sd, and give 0.7 deg of
internal rotation at 30 deg where its Table 4 gives 1.0."""
