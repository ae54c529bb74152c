"""Effects of the tissues: insertions, bundles and way of ligaments, cartilage and menisci."""

from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.model.effects.effect import (
    InputsChange,
    PartOfEffect,
    amplitudes,
    effect_of,
    with_remeasured_lengths,
)
from identknee.model.mechanics_inputs import PER_PCT, MechanicsInputs, with_lines
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, IntArray, array, declared, entry
from identknee.subject.anatomy import anatomy
from identknee.subject.knee import AXES, BONES, Knee
from identknee.subject.menisci import MENISCI, MOST_OFFSET, MOST_STIFFNESS, SIDES

SHIFT_SD, SHIFT_LIMIT = 2.0, 8.0  # mm


def insertion(knee: Knee) -> InputsChange:
    """Shifts of both insertions of every ligament along the axes of their bone [mm].

    The reference length is that between the shifted insertions in the scanned pose. The size,
    errors of segmentation of 1 to 4 mm, is an estimate.
    """
    names = [
        f"{x.name}_{bone}_{axis}_mm" for x in knee.ligaments for bone in BONES for axis in AXES
    ]
    n = len(names)
    return effect_of(
        *(InputsChange, "insertion", names, n * [SHIFT_SD]),
        upper=n * [SHIFT_LIMIT],
        changed=_shifted,
        differs_by_replica=True,
    )


def _shifted(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    is_own = setting.owner >= 0
    shifts = np.zeros((len(is_own), 2, 3))
    of_ligament = np.moveaxis(values.reshape(*values.shape[:-1], -1, 2, 3), -3, 0)
    copies = () if values.ndim == 1 else (setting.copy[is_own],)
    shifts[is_own] = of_ligament[setting.owner[is_own], *copies]
    lines = setting.lines
    moved = replace(lines, femoral=lines.femoral + shifts[:, 0], tibial=lines.tibial + shifts[:, 1])
    return with_remeasured_lengths(setting, moved, is_own)


# The insertions of one specimen (s192803) from CT and from MRI differ by 9 mm rms, that is 5 mm
# along each axis (docs/uncertain_geometry.md).
GROSS_SD, FARTHEST = 5.0, 25.0  # mm
# Names of the positive and the negative direction along x, y and z of a right knee.
WAYS = (("anterior", "posterior"), ("proximal", "distal"), ("lateral", "medial"))
# Shifts below this share of the largest are not reported.
LEAST_NAMED = 0.25


@declared
class InsertionShift(PartOfEffect):
    """A gross shift of one insertion, beside the small shifts of all insertions [mm]."""

    ligament: str = entry("Ligament whose insertion it is")
    bone: str = entry("Bone on which the insertion lies")

    @property
    def variant(self) -> str:
        """Which insertion it is."""
        return f"{self.ligament}_{self.bone}"

    def applied(self, knee: Knee, values: Array) -> Knee:
        """The knee with the insertion shifted by `values` [mm], shape ``(3,)``."""
        frame = knee.femur_frame if self.bone == BONES[0] else knee.tibia_frame
        ligaments = [
            replace(x, **{self.bone: getattr(x, self.bone) + values @ frame.axes})
            if x.name == self.ligament
            else x
            for x in knee.ligaments
        ]
        return replace(knee, ligaments=tuple(ligaments))


def moved_insertion(knee: Knee, ligament: str, bone: str) -> InsertionShift:
    """The insertion of a ligament on a bone, ``"femur"`` or ``"tibia"``, as a cause of its own.

    Raises
    ------
    ValueError
        If there is no such ligament or bone.
    """
    shifts = insertion(knee)
    place = 2 * [x.name for x in knee.ligaments].index(ligament) + BONES.index(bone)
    names = [f"{ligament}_{bone}_{way}_mm" for way, _ in WAYS]
    n = len(WAYS)
    made = amplitudes(shifts.name, names, n * [GROSS_SD], upper=n * [FARTHEST])
    moved = n * place + np.arange(n)
    return InsertionShift(ligament=ligament, bone=bone, whole=shifts, moved=moved, parameters=made)


def direction_words(shifts: Mapping[str, float]) -> str:
    """Direction in which an insertion is displaced; empty for other causes.

    Parameters
    ----------
    shifts
        Shifts by their names in `moved_insertion` [mm].

    Examples
    --------
    >>> shifts = {"anterior": 0.2, "proximal": -6.0, "lateral": 1.1}
    >>> direction_words({f"PT_tibia_{way}_mm": x for way, x in shifts.items()})
    'The insertion of the PT on the tibia lies 6.0 mm more distal than given.'
    """
    ways = {f"_{way}_mm": (way, back) for way, back in WAYS}
    found = {name: end for name in shifts for end in ways if name.endswith(end)}
    if len(found) != len(WAYS) or len(found) != len(shifts):
        return ""
    name, end = next(iter(found.items()))
    ligament, _, bone = name.removesuffix(end).rpartition("_")
    largest = max(abs(x) for x in shifts.values())
    phrases = [
        f"{abs(shifts[x]):.1f} mm more {ways[end][shifts[x] < 0.0]}"
        for x, end in sorted(found.items(), key=lambda item: -abs(shifts[item[0]]))
        if abs(shifts[x]) >= LEAST_NAMED * largest
    ]
    return f"The insertion of the {ligament} on the {bone} lies {' and '.join(phrases)} than given."


CONTACT_LAW = "contact_law"
# Standard deviation of the logarithm of the modulus: over knees, and by errors of the computation.
CARTILAGE_SD, NUMERICAL_SD = 0.7, 0.15
EXPONENT_SD = 0.3


@declared
class Cartilage:
    """Another contact law: logarithm of its modulus over the paper's, and change of exponent."""

    name: str = entry("Name of the cause", default="cartilage")
    modulus_sd: float = entry(
        "Prior standard deviation of the logarithm of the modulus", default=CARTILAGE_SD
    )
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        made = amplitudes(
            self.name,
            ["ln_modulus", "exponent"],
            [self.modulus_sd, EXPONENT_SD],
            lower=[-2.5, -0.3],
            upper=[2.5, 1.5],
        )
        object.__setattr__(self, "parameters", made)

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the other contact law."""
        law = replace(
            setting.law,
            modulus=setting.law.modulus * float(np.exp(values[0])),
            exponent=setting.law.exponent + float(values[1]),
        )
        return replace(setting, law=law)


def contact_nuisance() -> Cartilage:
    """Uncertainty of the contact law, as a nuisance parameter."""
    return Cartilage(name=CONTACT_LAW, modulus_sd=NUMERICAL_SD)


# Length of the springs [mm]: so long that they hardly turn, and resist motion along one axis only.
FAR = 500.0
# A negative transition strain stands for a spring that is linear in tension and compression.
BILATERAL = -1.0


@declared
class Meniscus:
    """Springs along and across each plateau, of one stiffness for each side [N/mm].

    They are relaxed in the scanned pose.
    """

    name: str = entry("Name of the cause", default="meniscus")
    femoral: Array = array(
        "Femoral ends of all springs in femoral axes, two springs for each amplitude",
        "4",
        "axis",
        unit="mm",
    )
    tibial: Array = array("Their tibial ends in tibial axes", "4", "axis", unit="mm")
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = ["medial_N_per_mm", "lateral_N_per_mm"]
        made = amplitudes(self.name, names, [20.0, 20.0], lower=[0.0, 0.0], upper=[100.0, 100.0])
        object.__setattr__(self, "parameters", made)

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the springs added."""
        springs = LineLigaments(
            femoral=self.femoral,
            tibial=self.tibial,
            reference_length=np.full(4, FAR),
            transition=BILATERAL,
        )
        return with_lines(setting, springs, FAR * np.repeat(values, 2), np.zeros(4))


def meniscus(knee: Knee) -> Meniscus:
    """Menisci as springs against sliding [N/mm], from the condyles' centres along the tibia's axes.

    The size, 5 to 50 N/mm, is an estimate. Models without menisci lack a restraint of sliding.
    """
    anterior, _, lateral = knee.tibia_frame.axes
    ends = [
        (side.condyle_centre, side.condyle_centre + FAR * along)
        for side in anatomy(knee).compartments
        for along in (anterior, lateral)
    ]
    return Meniscus(
        femoral=knee.femur_frame.to_local([x for x, _ in ends]),
        tibial=knee.tibia_frame.to_local([x for _, x in ends]),
    )


# Prior standard deviations of the stiffness of a meniscus [N/mm3] and of its height [mm].
WEDGE_SD, OFFSET_SD = 1.0, 0.5


def meniscal_wedge() -> InputsChange:
    """The menisci as wedges that fill the gaps around the plateaus in the scanned pose.

    The amplitudes are the pressure over the compression of each meniscus [N/mm3], and how much
    higher both are than the gaps [mm]. Menisci press where a gap closes, and so resist tilting,
    compression and sliding; see `identknee.subject.menisci`.
    """
    return effect_of(
        InputsChange,
        MENISCI,
        [*(f"{x}_stiffness_N_per_mm3" for x in SIDES), "offset_mm"],
        [WEDGE_SD, WEDGE_SD, OFFSET_SD],
        lower=[0.0, 0.0, -MOST_OFFSET],
        upper=[MOST_STIFFNESS, MOST_STIFFNESS, MOST_OFFSET],
        changed=_with_wedges,
    )


def _with_wedges(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    return replace(setting, menisci=np.array(values))


BUNDLES = "bundles"
SPREAD_SD, SPREAD_LIMIT = 5.0, 30.0  # %
PLACE_SD, PLACE_LIMIT = 4.0, 16.0  # mm


def bundles(knee: Knee) -> InputsChange:
    """Two bundles in place of every ligament, that differ in reference strain and insertions.

    Each bundle has half of the stiffness. The amplitudes are the spread of reference strain [%] and
    the distances of the two insertions on each bone along its axes [mm]. The first bundle has half
    of each spread more than the ligament, the second half of it less. Reference lengths are those
    between the bundles' own insertions in the scanned pose. Bundles of published models differ by
    4 % (anterior cruciate) to 21 % (posterior cruciate) and 33 % (lateral collateral) [1]_;
    distances of 4 mm are an estimate. Where strains do not differ, nothing changes to first order.
    All lines of a group are split alike and share its amplitudes.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    ligaments = list(dict.fromkeys(knee.owners))
    strains = [f"{x}_strain_spread_pct" for x in ligaments]
    places = [
        f"{ligament}_{bone}_{axis}_spread_mm"
        for ligament in ligaments
        for bone in BONES
        for axis in AXES
    ]
    n, m = len(strains), len(places)
    return effect_of(
        InputsChange,
        BUNDLES,
        strains + places,
        n * [SPREAD_SD] + m * [PLACE_SD],
        lower=n * [0.0] + m * [-PLACE_LIMIT],
        upper=n * [SPREAD_LIMIT] + m * [PLACE_LIMIT],
        changed=partial(_split, np.array([ligaments.index(x) for x in knee.owners])),
        differs_by_replica=True,
    )


@declared
class LigamentBundles(PartOfEffect):
    """Bundles of one ligament of a knee; the other ligaments stay whole."""

    ligament: str = entry("Name of the ligament, or of the group of its lines")

    @property
    def variant(self) -> str:
        """The ligament, which tells the parts of this effect apart."""
        return self.ligament


def bundles_of_each(knee: Knee) -> tuple[LigamentBundles, ...]:
    """One cause for each ligament: its bundles."""
    whole = bundles(knee)
    p, names = whole.parameters, whole.parameters.names
    n = p.n // (1 + len(BONES) * len(AXES))
    found = []
    for i in range(n):
        ligament = names[i].partition(".")[2].removesuffix("_strain_spread_pct")
        moved = np.r_[i, n + 6 * i + np.arange(6)]
        own = p.select([names[k] for k in moved])
        found.append(LigamentBundles(ligament=ligament, whole=whole, moved=moved, parameters=own))
    return tuple(found)


def _split(ligament: IntArray, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    is_own, lines = setting.owner >= 0, setting.lines
    # The first bundle takes the place of its line; second bundles follow after all lines.
    line = np.r_[np.arange(is_own.size), np.flatnonzero(is_own)]
    owner = setting.owner[line]
    side = np.where(owner >= 0, 0.5, 0.0)
    side[is_own.size :] *= -1.0
    # Lines without a ligament (owner -1) get any value here: `side` is 0 for them.
    of = ligament[owner]
    n = values.shape[-1] // (1 + len(BONES) * len(AXES))
    each = values if values.ndim > 1 else values[None]
    row = setting.copy[line] if values.ndim > 1 else np.zeros(line.size, int)
    strains, places = each[:, :n], each[:, n:].reshape(-1, n, len(BONES), len(AXES))
    aside = side[:, None, None] * places[row, of]
    half = np.where(owner >= 0, 0.5, 1.0)
    whole = lines.take(line)
    bundled = replace(whole, femoral=whole.femoral + aside[:, 0], tibial=whole.tibial + aside[:, 1])
    split = replace(
        setting,
        stiffness=half * setting.stiffness[line],
        reference_strain=setting.reference_strain[line] + PER_PCT * side * strains[row, of],
        owner=owner,
        share=half * setting.share[line],
        copy=setting.copy[line],
    )
    return with_remeasured_lengths(split, bundled, owner >= 0)


def toe_strain() -> InputsChange:
    """Another transition strain of all ligaments of the subject, as a change from 3 % [%].

    Knee models have used 3 % since [1]_. The range of 1.5 to 4.5 % is an estimate.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    return effect_of(
        *(InputsChange, "toe_strain", ["transition_strain_pct"], [1.0]),
        lower=[-2.0],
        upper=[3.0],
        changed=_stretched,
    )


def _stretched(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    is_own = setting.owner >= 0
    transition = setting.lines.transition + np.where(is_own, 0.01 * values[0], 0.0)
    return replace(setting, lines=replace(setting.lines, transition=transition))


WRAPPING = "mcl_wrapping"


def mcl_wrapping(knee: Knee) -> InputsChange:
    """Lift of the medial collateral ligament off its straight line, at the joint line [mm].

    The rim of the plateau and the meniscus push the ligament medially. Its reference length is that
    of the lifted course. The size, 2 to 8 mm, is an estimate. The length changes with the square of
    a small lift, so that the first derivative at zero is zero.

    Raises
    ------
    ValueError
        If no ligament of the subject runs as the medial collateral does.
    """
    found = anatomy(knee)
    if found.medial_collateral is None:
        raise ValueError(
            f"{WRAPPING} needs a medial collateral ligament, and no ligament of this knee runs "
            "like one; leave the effect out"
        )
    ligament = knee.ligament(found.medial_collateral)
    bottom, top = knee.tibia_frame.to_local([ligament.tibia, ligament.femur])[:, 1]
    if ligament.wrap is not None:
        raise ValueError(
            f"{WRAPPING} needs a straight ligament, and {ligament.name} wraps around an obstacle; "
            "leave the effect out"
        )
    index = [x.name for x in knee.ligaments].index(ligament.name)
    place = float((found.joint_line - bottom) / (top - bottom))
    return effect_of(
        *(InputsChange, WRAPPING, ["lift_mm"], [4.0]),
        lower=[0.0],
        upper=[12.0],
        changed=partial(_with_wrapping, index, place),
    )


def _with_wrapping(
    index: int, place: float, setting: MechanicsInputs, values: Array
) -> MechanicsInputs:
    is_lifted, lines = setting.owner == index, setting.lines
    course = replace(
        lines,
        # Femoral z points laterally.
        wrap_offset=np.where(is_lifted, -values[0], lines.wrap_offset),
        wrap_place=np.where(is_lifted, place, lines.wrap_place),
    )
    return with_remeasured_lengths(setting, course, is_lifted)
