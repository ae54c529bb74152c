"""All hidden effects by name."""

from types import MappingProxyType

from identknee.blind import rig, structures
from identknee.blind.hidden import Draw

# Effects whose name a diagnosis can give.
LISTED: MappingProxyType[str, Draw] = MappingProxyType(
    {
        "anterolateral": structures.structure("anterolateral", smallest_kN=0.5, largest_kN=2.5),
        "posteromedial": structures.structure("posteromedial", smallest_kN=0.7, largest_kN=3.0),
        "popliteofibular": structures.structure("popliteofibular", smallest_kN=0.7, largest_kN=3.0),
        "deep_mcl": structures.structure("deep_mcl", smallest_kN=0.7, largest_kN=2.5),
        "posterior_capsule": structures.posterior_capsule,
        "bundles": structures.bundles,
        "mcl_wrapping": structures.mcl_wrapping,
        "meniscus": structures.meniscus,
        "toe_strain": structures.toe_strain,
        "cartilage": structures.cartilage,
        "compression": rig.compression,
        "shank_gravity": rig.shank_gravity,
        "muscle_tension": rig.muscle_tension,
        "moment_gain_IE": rig.moment_gain("IE"),
        "moment_gain_VV": rig.moment_gain("VV"),
        "moment_offset": rig.moment_offset,
        "axis_misalignment": rig.axis_misalignment,
        "parasitic_shear": rig.parasitic_shear,
        "femur_frame": rig.femur_frame,
        "tibia_frame": rig.tibia_frame,
        "flexion_offset": rig.flexion_offset,
        "rig_compliance_IE": rig.rig_compliance("IE"),
        "rig_compliance_VV": rig.rig_compliance("VV"),
        "insertion": structures.insertion,
        "hysteresis": rig.hysteresis,
        "creep": rig.creep,
        "drift": rig.drift,
    }
)
# Effects that the library does not list: the right diagnosis is that the cause has no name.
UNLISTED: MappingProxyType[str, Draw] = MappingProxyType(
    {
        "missing_line": structures.missing_line,
        "broad_strap": structures.broad_strap,
        "two_point_tether": structures.two_point_tether,
        "rotational_spring": structures.rotational_spring,
        "constant_pull": rig.constant_pull,
        "one_way_yield": rig.one_way_yield,
    }
)
# Listed effects that "random" does not draw, so that earlier seeds still give the same cases.
BY_NAME: MappingProxyType[str, Draw] = MappingProxyType(
    {"meniscal_wedge": structures.meniscal_wedge}
)
# Effects that depend on when a trial was made and in which direction the load went.
HISTORY = frozenset({"hysteresis", "creep", "drift"})
EFFECTS: MappingProxyType[str, Draw] = MappingProxyType({**LISTED, **UNLISTED, **BY_NAME})
