"""Missing structures, the capsule and the menisci restrain what they are known to restrain."""

import numpy as np
import pytest
from line_gradient import line_gradient

from identknee.laxity.protocol import Protocol
from identknee.model.effects.library import effect_named
from identknee.model.effects.structures import PosteriorCapsule, lines_of, structure
from identknee.model.effects.tissues import Meniscus
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.knee import Knee

INTERNAL, EXTERNAL, VALGUS, VARUS = (5.0, 0.0), (-5.0, 0.0), (0.0, -8.0), (0.0, 8.0)
VARUS_DEG, INTERNAL_DEG = 3, 4


def coordinates(
    knee: Knee,
    flexion: float,
    moments: tuple[float, float],
    *,
    anterior_N: float = 0.0,
    **amplitudes: float,
) -> Array:
    """Coordinates (5,) of one trial with amplitudes of effects by ``effect__amplitude``."""
    protocol = Protocol(
        name="one",
        trials=("one",),
        flexion_deg=np.array([flexion]),
        loads=np.array([[*moments, anterior_N, 0.0, 0.0]]),
    )
    names = dict.fromkeys(x.partition("__")[0] for x in amplitudes)
    model = LaxityModel(
        knee=knee, protocol=protocol, effects=tuple(effect_named(knee, x) for x in names)
    )
    theta = model.parameters.vector({k.replace("__", "."): v for k, v in amplitudes.items()})
    found: Array = model.predict(theta, derivatives=False).coordinates[0]
    return found


@pytest.mark.parametrize(
    ("name", "flexion", "moments", "column", "sign"),
    [
        ("anterolateral", 30.0, INTERNAL, INTERNAL_DEG, 1.0),
        ("posteromedial", 0.0, INTERNAL, INTERNAL_DEG, 1.0),
        ("posteromedial", 0.0, VALGUS, VARUS_DEG, -1.0),
        ("popliteofibular", 30.0, EXTERNAL, INTERNAL_DEG, -1.0),
        ("popliteofibular", 30.0, VARUS, VARUS_DEG, 1.0),
        ("deep_mcl", 0.0, VALGUS, VARUS_DEG, -1.0),
        ("deep_mcl", 30.0, EXTERNAL, INTERNAL_DEG, -1.0),
    ],
)
def test_a_structure_takes_part_of_a_rotation(
    name: str,
    flexion: float,
    moments: tuple[float, float],
    column: int,
    sign: float,
    reference: Knee,
) -> None:
    strain = {f"{name}__reference_strain_pct": 3.0}
    free = coordinates(reference, flexion, moments, **{f"{name}__stiffness_kN": 0.0}, **strain)
    held = coordinates(reference, flexion, moments, **{f"{name}__stiffness_kN": 1.4}, **strain)
    assert sign * (free - held)[column] > 0.05


def test_the_capsule_holds_near_extension_alone(reference: Knee) -> None:
    taut = {
        "posterior_capsule__medial_stiffness_kN": 2.0,
        "posterior_capsule__lateral_stiffness_kN": 2.0,
    }
    change = [
        np.abs(coordinates(reference, x, VALGUS, **taut) - coordinates(reference, x, VALGUS)).max()
        for x in (0.0, 60.0)
    ]
    assert change[0] > 1e-3
    assert change[1] < 0.1 * change[0]


def test_the_sides_of_the_capsule_have_their_own_stiffness_and_place(reference: Knee) -> None:
    capsule = effect_named(reference, "posterior_capsule")
    assert isinstance(capsule, PosteriorCapsule)
    model = LaxityModel(knee=reference, protocol=_rest(), effects=(capsule,))
    theta = model.parameters.vector(
        {
            "posterior_capsule.medial_stiffness_kN": 1.0,
            "posterior_capsule.lateral_stiffness_kN": 2.0,
            "posterior_capsule.reference_strain_pct": -3.0,
            "posterior_capsule.medial_femur_y_mm": 2.0,
            "posterior_capsule.lateral_tibia_x_mm": -5.0,
        }
    )
    setting = model.setting(theta)
    np.testing.assert_allclose(
        setting.lines.femoral[-2:] - [capsule.medial.femoral[0], capsule.lateral.femoral[0]],
        [[0.0, 2.0, 0.0], [0.0, 0.0, 0.0]],
        atol=1e-9,
    )
    np.testing.assert_allclose(
        setting.lines.tibial[-2:] - [capsule.medial.tibial[0], capsule.lateral.tibial[0]],
        [[0.0, 0.0, 0.0], [-5.0, 0.0, 0.0]],
        atol=1e-9,
    )
    np.testing.assert_allclose(setting.stiffness[-2:], [1000.0, 2000.0])
    np.testing.assert_allclose(setting.reference_strain[-2:], -0.03)
    assert setting.lines.tibial[-2, 2] < setting.lines.tibial[-1, 2]
    with pytest.raises(ValueError, match="got 1 lines"):
        structure(reference, "posterior_capsule", lines_of(reference, capsule)[:1])


def test_meniscus_springs_run_along_the_tibia_from_the_condyles(reference: Knee) -> None:
    meniscus = effect_named(reference, "meniscus")
    assert isinstance(meniscus, Meniscus)
    assert (meniscus.femoral[:2, 2] < 0.0).all()
    assert (meniscus.femoral[2:, 2] > 0.0).all()
    ways = (meniscus.tibial - meniscus.femoral) / np.linalg.norm(
        meniscus.tibial - meniscus.femoral, axis=1, keepdims=True
    )
    # Both frames of the reference knee are the same.
    np.testing.assert_allclose(
        ways, np.tile([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], (2, 1)), atol=1e-12
    )


def test_menisci_resist_sliding_by_their_stiffness(reference: Knee) -> None:
    """1 mm forwards or aside is held by the sum of both; along the tibia nothing is."""
    meniscus = effect_named(reference, "meniscus")
    assert isinstance(meniscus, Meniscus)
    model = LaxityModel(knee=reference, protocol=_rest(), effects=(meniscus,))
    theta = model.parameters.vector(
        {"meniscus.medial_N_per_mm": 12.0, "meniscus.lateral_N_per_mm": 30.0}
    )
    springs = model.setting(theta)
    bare = model.setting(model.parameters.center)
    start, flexion = model.joint.start, np.array([model.joint.start_flexion])

    def force(move: Array) -> Array:
        pose = (start + move)[None]
        moved: Array = (line_gradient(springs, flexion, pose) - line_gradient(bare, flexion, pose))[
            0
        ]
        return moved

    assert np.abs(force(np.zeros(5))).max() < 1e-9
    # A spring of 500 mm turns a little as its end moves: by a 500th of the force.
    for axis, wanted in ((2, [42.0, 0.0, 0.0]), (4, [0.0, 0.0, 42.0]), (3, [0.0, 0.0, 0.0])):
        np.testing.assert_allclose(force(np.eye(5)[axis])[2:], wanted, atol=42.0 / 500.0)


def _rest() -> Protocol:
    return Protocol(
        name="rest", trials=("rest",), flexion_deg=np.array([0.0]), loads=np.zeros((1, 5))
    )


@pytest.mark.parametrize(("moments", "side"), [(VALGUS, "lateral"), (VARUS, "medial")])
def test_the_wedge_of_the_loaded_side_resists_tilting(
    moments: tuple[float, float], side: str, reference: Knee
) -> None:
    """It presses where the tilt closes the gap; the other one is idle."""
    other = {"medial": "lateral", "lateral": "medial"}[side]
    free, held, idle = (
        coordinates(reference, 60.0, moments, **{f"meniscal_wedge__{x}_stiffness_N_per_mm3": k})
        for x, k in ((side, 0.0), (side, 1.0), (other, 1.0))
    )
    sign = np.sign(moments[1])
    assert sign * (free - held)[VARUS_DEG] > 0.5
    assert abs((free - idle)[VARUS_DEG]) < 0.1


def test_wedges_resist_the_anterior_drawer_of_a_flexed_knee(reference: Knee) -> None:
    """Their rear rises against the condyles when the tibia slides forwards."""
    free, held = (
        coordinates(
            reference,
            60.0,
            (0.0, 0.0),
            anterior_N=60.0,
            meniscal_wedge__medial_stiffness_N_per_mm3=k,
            meniscal_wedge__lateral_stiffness_N_per_mm3=k,
        )
        for k in (0.0, 1.0)
    )
    assert (free - held)[1] > 1.0
