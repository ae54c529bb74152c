"""Facts about each cause: its meaning, plausible size with source, and smallest relevant size.

Where a source is called an estimate, the size is ours or common in the field.

References
----------
.. [1] Helito et al. (2016), BMC Musculoskelet. Disord. 17, 193.
       https://doi.org/10.1186/s12891-016-1052-5
.. [2] Zens et al. (2015), J. Exp. Orthop. 2, 7. https://doi.org/10.1186/s40634-015-0023-3
.. [3] Robinson et al. (2005), J. Biomech. 38(5), 1067-1074.
       https://doi.org/10.1016/j.jbiomech.2004.05.034
.. [4] Willinger et al. (2020), Knee Surg. Sports Traumatol. Arthrosc. 28, 3720-3732.
       https://doi.org/10.1007/s00167-020-06050-0
.. [5] LaPrade et al. (2005), Am. J. Sports Med. 33(9), 1386-1391.
       https://doi.org/10.1177/0363546504274143
.. [6] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
       https://doi.org/10.1115/1.2894883
.. [7] Shin et al. (2007), J. Biomech. 40(5), 1145-1152.
       https://doi.org/10.1016/j.jbiomech.2006.05.004
"""

from collections.abc import Mapping
from types import MappingProxyType

from identknee.model.effects.effect import OF
from identknee.runs.declare import declared, entry

MISSING_LINE, REMOUNTING = "missing_line", "remounting"
# Causes that no library offers: they are tried where others fail.
NOT_OFFERED = (MISSING_LINE, REMOUNTING)


@declared
class EffectFacts:
    """Label, meaning, size and source of a cause."""

    name: str = entry("Name of the cause")
    label: str = entry("What prose calls it")
    sentence: str = entry("What it is")
    source: str = entry("Source of its plausible size")
    relevant: float = entry(
        "The smallest amplitude worth knowing, in the unit of the effect's first parameter"
    )
    is_numerical: bool = entry(
        "Whether it stands for what a computation gets wrong of any knee: allowed for, never "
        "a cause",
        default=False,
    )


_ESTIMATE = "an estimate"
_ALL = (
    EffectFacts(
        name="anterolateral",
        label="anterolateral structure",
        sentence="An anterolateral structure resists internal rotation, most at 30 to 60 deg.",
        source="0.14 kN (50 N at 36 % strain, Zens 2015) to 1.4 kN (42 +- 26 N/mm, Helito 2016, at "
        "33 mm)",
        relevant=0.2,
    ),
    EffectFacts(
        name="posteromedial",
        label="posteromedial corner",
        sentence="The posterior oblique ligament and the posteromedial capsule resist internal and "
        "valgus rotation near extension and slacken with flexion.",
        source="56 +- 20 N/mm (Robinson 2005): 1 to 3 kN; course with flexion (Willinger 2020)",
        relevant=0.2,
    ),
    EffectFacts(
        name="popliteofibular",
        label="popliteofibular ligament",
        sentence="The popliteofibular ligament and the popliteus tendon resist external and varus "
        "rotation, more with flexion.",
        source="28.6 N/mm and 83.7 N/mm (LaPrade 2005): 1 to 3 kN",
        relevant=0.2,
    ),
    EffectFacts(
        name="deep_mcl",
        label="deep MCL",
        sentence="The deep medial collateral ligament resists valgus and external rotation.",
        source="42 N/mm (Robinson 2005): 1 to 2 kN",
        relevant=0.2,
    ),
    EffectFacts(
        name="posterior_capsule",
        label="posterior capsule",
        sentence="The posterior capsule resists extension and what tilts or turns the knee there.",
        source="bundles of published models (Shin 2007): about 1 kN each, an estimate",
        relevant=0.3,
    ),
    EffectFacts(
        name="bundles",
        label="ligament bundles",
        sentence="A ligament's fibres do not tighten together: one bundle is tauter than another "
        "and lies beside it.",
        source="bundles of one ligament differ by 4 to 33 % (Blankevoort 1991); their insertions "
        f"are 4 mm apart, {_ESTIMATE}",
        relevant=2.0,
    ),
    EffectFacts(
        name="mcl_wrapping",
        label="MCL wrapping",
        sentence="The medial collateral ligament is pushed aside at the joint line, so it is no "
        "straight line.",
        source=f"2 to 8 mm, {_ESTIMATE}",
        relevant=2.0,
    ),
    EffectFacts(
        name="meniscus",
        label="menisci",
        sentence="The menisci resist sliding of the condyles on the plateaus.",
        source=f"5 to 50 N/mm, {_ESTIMATE}",
        relevant=3.0,
    ),
    EffectFacts(
        name="meniscal_wedge",
        label="meniscal wedges",
        sentence="The menisci fill the gaps around the plateaus and resist their closing.",
        source="half of 1,000 N (Walker 1975) on 70 % of 1,150 mm2 (Fukubayashi 1980), as if "
        f"compressed by 0.2 to 2 mm, {_ESTIMATE}",
        relevant=0.2,
    ),
    EffectFacts(
        name="toe_strain",
        label="toe region of the ligaments",
        sentence="The ligaments straighten over another range of strain than 3 %.",
        source=f"1.5 to 4.5 %, {_ESTIMATE} around the usual value (Blankevoort 1991)",
        relevant=0.5,
    ),
    EffectFacts(
        name="cartilage",
        label="cartilage stiffness",
        sentence="Cartilage is softer or stiffer than the contact law says.",
        source=f"a tenth to three times the modulus, {_ESTIMATE}",
        relevant=0.4,
    ),
    EffectFacts(
        name="compression",
        label="axial compression",
        sentence="A constant axial force pressed the joint together in all trials.",
        source=f"20 N to seat a knee in a rig, 20 to 200 N of muscle tone, {_ESTIMATE}",
        relevant=10.0,
    ),
    EffectFacts(
        name="shank_gravity",
        label="shank weight",
        sentence="The weight of shank and foot acted and was not taken off the loads.",
        source=f"0 N where it was tared to 35 N, {_ESTIMATE}",
        relevant=4.0,
    ),
    EffectFacts(
        name="muscle_tension",
        label="muscle tension",
        sentence="Muscles pulled in all trials, as they do in a person who is not quite relaxed.",
        source=f"0 to 150 N of muscle tone in each, {_ESTIMATE}; lines of action (Herzog 1993, "
        "J. Anat. 182, 213)",
        relevant=15.0,
    ),
    EffectFacts(
        name="moment_gain_IE",
        label="scale error of the internal moment",
        sentence="The internal and external moments were larger or smaller than stated.",
        source=f"1 % of full scale for load cells, 5 to 10 % by hand, {_ESTIMATE}",
        relevant=0.03,
    ),
    EffectFacts(
        name="moment_gain_VV",
        label="scale error of the varus moment",
        sentence="The varus and valgus moments were larger or smaller than stated.",
        source=f"1 % of full scale for load cells, 5 to 10 % by hand, {_ESTIMATE}",
        relevant=0.03,
    ),
    EffectFacts(
        name="moment_offset",
        label="zero error of the moments",
        sentence="The moments had a zero error.",
        source=f"0.5 N·m tolerance of control, {_ESTIMATE}",
        relevant=0.15,
    ),
    EffectFacts(
        name="axis_misalignment",
        label="misaligned moment axes",
        sentence="Each moment acted partly about the other's axis.",
        source=f"2 to 8 deg, {_ESTIMATE}",
        relevant=1.0,
    ),
    EffectFacts(
        name="parasitic_shear",
        label="parasitic shear force",
        sentence="Each moment came with a force across the tibia.",
        source=f"2 to 12 N at 10 N·m, {_ESTIMATE}",
        relevant=0.3,
    ),
    EffectFacts(
        name="femur_frame",
        label="rotated femoral frame",
        sentence="The femur's axes were turned against those of the model.",
        source=f"1 to 5 deg where axes come from landmarks, {_ESTIMATE}",
        relevant=0.5,
    ),
    EffectFacts(
        name="tibia_frame",
        label="rotated tibial frame",
        sentence="The tibia's axes were turned against those of the model.",
        source=f"1 to 5 deg where axes come from landmarks, {_ESTIMATE}",
        relevant=0.5,
    ),
    EffectFacts(
        name="flexion_offset",
        label="flexion offset",
        sentence="The knee was flexed more or less than stated.",
        source=f"1 to 4 deg, {_ESTIMATE}",
        relevant=1.0,
    ),
    EffectFacts(
        name="rig_compliance_IE",
        label="rig compliance in internal rotation",
        sentence="The rig itself yielded in internal and external rotation.",
        source=f"0.01 to 0.05 deg/N·m with pins in bone, 0.2 to 1 deg/N·m in a boot, {_ESTIMATE}",
        relevant=0.03,
    ),
    EffectFacts(
        name="rig_compliance_VV",
        label="rig compliance in varus rotation",
        sentence="The rig itself yielded in varus and valgus rotation.",
        source=f"0.01 to 0.05 deg/N·m with pins in bone, 0.2 to 1 deg/N·m in a boot, {_ESTIMATE}",
        relevant=0.03,
    ),
    EffectFacts(
        name="insertion",
        label="ligament insertions",
        sentence="Ligaments are attached beside where they were segmented.",
        source=f"1 to 4 mm, {_ESTIMATE}",
        relevant=1.0,
    ),
    EffectFacts(
        name="hysteresis",
        label="hysteresis",
        sentence="Readings lag behind the load, so loading and unloading differ.",
        source=f"0.3 to 3 deg of internal rotation, {_ESTIMATE}",
        relevant=0.3,
    ),
    EffectFacts(
        name="creep",
        label="creep",
        sentence="The knee gave way under load more and more while it was tested.",
        source=_ESTIMATE,
        relevant=0.3,
    ),
    EffectFacts(
        name="drift",
        label="drift of the readings",
        sentence="The readings wandered over the test series whatever the load.",
        source=f"0.1 to 1 mm or deg, {_ESTIMATE}",
        relevant=0.2,
    ),
    EffectFacts(
        name="contact_law",
        label="contact law",
        sentence="The computed contact is not quite the knee's: its law, its surfaces, its points.",
        source=f"a quarter of the modulus, {_ESTIMATE}",
        relevant=0.4,
        is_numerical=True,
    ),
    EffectFacts(
        name=REMOUNTING,
        label="zero error of each flexion angle",
        sentence="All trials of a flexion angle share errors of zero, as if the knee was mounted "
        "again for each: state them, for example --uncertain zero=0.3mm,zero=0.3deg.",
        source=f"0.3 mm and 0.3 deg, {_ESTIMATE}",
        relevant=0.1,
    ),
    EffectFacts(
        name=MISSING_LINE,
        label="unknown line of action",
        sentence="A line of action that no structure of the library has.",
        source="found in the data",
        relevant=0.2,
    ),
)
FACTS: Mapping[str, EffectFacts] = MappingProxyType({x.name: x for x in _ALL})


def facts_of(name: str) -> EffectFacts | None:
    """The facts about a cause, which may be that of one rig; None for a caller's own effect."""
    return FACTS.get(name.rpartition(OF)[2])


def cause_label(name: str) -> str:
    """The label of a cause in sentences; the name for a caller's own effect.

    Examples
    --------
    >>> cause_label("rig_compliance_IE"), cause_label("my_effect")
    ('rig compliance in internal rotation', 'my effect')
    >>> cause_label("robot/flexion_offset"), cause_label("cut:ACL/flexion_offset")
    ('flexion offset of robot', 'flexion offset of the state cut: ACL')
    """
    scope, _, own = name.rpartition(OF)
    label = FACTS[own].label if own in FACTS else own.replace("_", " ")
    where = scope.replace("cut:", "the state cut: ").replace(",", ", ")
    return f"{label} of {where}" if scope else label
