"""Where the generator puts structures, from a subject's surfaces and collateral insertions."""

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.knee import Knee

# Distance of the epicondyles in the knee the offsets below were written down for [mm].
EPICONDYLES_MM = 83.0


@declared
class AnatomicalSites:
    """Anatomy of a right knee in its scanned pose [mm], the places of a bone in its frame."""

    scale: float = entry("Size of the knee over that of an average one")
    medial: int = entry("Number of the medial collateral ligament among the ligaments")
    lateral: int = entry("Number of the lateral collateral ligament")
    front: int = entry("Number of the anterior cruciate ligament")
    rear: int = entry("Number of the posterior cruciate ligament")
    epicondyles: Array = entry(
        "Medial and lateral femoral end of the collaterals, shape ``(2, 3)``"
    )
    plateaus: Array = entry(
        "Lowest corner, centroid and highest corner of the medial and lateral plateau, shape "
        "``(2, 3, 3)``"
    )
    fibula: Array = entry("Where the lateral collateral ends, shape ``(3,)``")
    femur: Array = entry("Lowest and highest corner of the femoral surface, shape ``(2, 3)``")


def anatomical_sites(knee: Knee) -> AnatomicalSites:
    """Anatomy of a knee.

    The collaterals are the ligaments farthest to either side; of the others the anterior cruciate
    runs most forward on its way down, and the posterior cruciate most backward.
    """
    femoral = np.array([knee.femur_frame.to_local(x.femur) for x in knee.ligaments])
    tibial = np.array([knee.tibia_frame.to_local(x.tibia) for x in knee.ligaments])
    across = femoral[:, 2] + tibial[:, 2]
    medial, lateral = int(np.argmin(across)), int(np.argmax(across))
    forward = tibial[:, 0] - femoral[:, 0] - 1e-3 * np.abs(across)
    is_outer = np.abs(across) > 0.6 * np.abs(across[[medial, lateral]]).mean()
    front = int(np.argmax(np.where(is_outer, -np.inf, forward)))
    rear = int(np.argmin(np.where(is_outer, np.inf, forward)))
    plateaus = sorted(
        (knee.tibia_frame.to_local(x.vertices) for x in knee.tibia), key=lambda x: x[:, 2].mean()
    )
    femur = knee.femur_frame.to_local(knee.femur.vertices)
    return AnatomicalSites(
        scale=float(femoral[lateral, 2] - femoral[medial, 2]) / EPICONDYLES_MM,
        medial=medial,
        lateral=lateral,
        front=front,
        rear=rear,
        epicondyles=femoral[[medial, lateral]],
        plateaus=np.array([[x.min(axis=0), x.mean(axis=0), x.max(axis=0)] for x in plateaus]),
        fibula=tibial[lateral],
        femur=np.array([femur.min(axis=0), femur.max(axis=0)]),
    )


def structure_insertions(places: AnatomicalSites) -> dict[str, tuple[Array, Array]]:
    """Femoral and tibial end of each structure a four-line knee lacks [mm], shape ``(3,)`` each.

    References
    ----------
    .. [1] Kennedy et al. (2015), Am. J. Sports Med. 43(7), 1606-1615 (anterolateral ligament).
           https://doi.org/10.1177/0363546515578253
    .. [2] LaPrade et al. (2007), J. Bone Joint Surg. 89(9), 2000-2010 (medial side).
           https://doi.org/10.2106/JBJS.F.01176
    .. [3] LaPrade et al. (2003), Am. J. Sports Med. 31(6), 854-860 (posterolateral side).
           https://doi.org/10.1177/03635465030310062101
    """
    s = places.scale
    medial, lateral = places.epicondyles
    (low_m, mid_m, _), (low_l, mid_l, high_l) = places.plateaus
    behind = places.femur[0, 0] - 1.0 * s
    return {
        "anterolateral": (
            lateral + s * np.array([-4.0, 4.0, 0.0]),
            np.array([places.fibula[0] + 22.0 * s, mid_l[1] - 8.0 * s, high_l[2] + 1.0 * s]),
        ),
        "posteromedial": (
            medial + s * np.array([-8.0, 0.0, 3.0]),
            np.array([low_m[0] + 2.0 * s, mid_m[1] - 5.0 * s, low_m[2] + 5.0 * s]),
        ),
        "popliteofibular": (
            lateral + s * np.array([3.0, -7.0, -3.0]),
            places.fibula + s * np.array([-4.0, 6.0, -5.0]),
        ),
        "deep_mcl": (
            medial + s * np.array([1.0, -7.0, 3.0]),
            np.array([mid_m[0], mid_m[1] - 6.0 * s, low_m[2] - 1.0 * s]),
        ),
        "posterior_capsule_medial": (
            np.array([behind, 8.0 * s, mid_m[2] - 3.0 * s]),
            np.array([low_m[0] - 2.0 * s, mid_m[1] - 9.0 * s, mid_m[2] - 1.0 * s]),
        ),
        "posterior_capsule_lateral": (
            np.array([behind, 8.0 * s, mid_l[2] - 1.0 * s]),
            np.array([low_l[0] - 2.0 * s, mid_l[1] - 9.0 * s, mid_l[2]]),
        ),
    }
