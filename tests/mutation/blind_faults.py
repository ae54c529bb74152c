"""Faults of the blind generator: it would flatter every diagnosis, or mislead it."""

from mutation import Mutation

_RIG = "tests/unit/blind/test_blind_rig.py"
_STRUCTURES = "tests/unit/blind/test_blind_structures.py"
_TRUTHS = "tests/unit/blind/test_blind_truths.py"
_CONDITIONS = "tests/unit/blind/test_blind_conditions.py"
_SCORE = "tests/unit/blind/test_blind_score.py"


def _fault(file: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    return Mutation(file=f"identknee/blind/{file}", old=old, new=new, why=why, tests=tests)


FAULTS = (
    _fault(
        "conditions.py",
        "    jitter_mm: float = 3.0\n",
        "    jitter_mm: float = 0.0\n",
        "every hidden structure lies exactly where the generator's table has it",
        _CONDITIONS,
        _STRUCTURES,
    ),
    _fault(
        "conditions.py",
        "    stiffness_log_sd: float = 0.2\n",
        "    stiffness_log_sd: float = 0.002\n",
        "true stiffnesses are the subject's own, where the fit starts",
        _TRUTHS,
    ),
    _fault(
        "conditions.py",
        "    strain_sd_pct: float = 1.0\n",
        "    strain_sd_pct: float = 0.01\n",
        "true reference strains are the subject's own, where the fit starts",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        "HEAVY_DEGREES if is_heavy else None,\n    )",
        "None,\n    )",
        "no case has heavy tails although its truth says so",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        "HEAVY_SHARE, HEAVY_DEGREES = 0.1, 5.0",
        "HEAVY_SHARE, HEAVY_DEGREES = 0.0, 5.0",
        "no case has heavy tails",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        "STATED_RANGE = (0.8, 1.2)",
        "STATED_RANGE = (1.0, 1.0 + 1e-9)",
        "the stated noise is the true one in every case",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        "        correlation=noise.correlation,\n        student",
        "        correlation=0.0,\n        student",
        "errors of a trial are independent, as the data state",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        "NULL_SHARE, UNLISTED_SHARE = 0.15, 0.15",
        "NULL_SHARE, UNLISTED_SHARE = 0.15, 0.0",
        "random cases never hide what no library lists",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        'else "unloading" if down else "loading"',
        'else "loading" if down else "unloading"',
        "the phase of every trial is told the wrong way round",
        _TRUTHS,
    ),
    _fault(
        "case.py",
        "(hidden.largest / hidden.smallest) ** share",
        "(hidden.largest / hidden.smallest) ** (0.01 * share)",
        "every effect has its smallest size",
        _TRUTHS,
    ),
    _fault(
        "rig.py",
        "way = np.array([-np.cos(angle), -np.sin(angle), 0.0])",
        "way = np.array([np.cos(angle), -np.sin(angle), 0.0])",
        "the shank's weight pulls forwards while the truth says backwards",
        _RIG,
    ),
    _fault(
        "rig.py",
        "SHANK_MM = 180.0",
        "SHANK_MM = 0.0",
        "the shank's weight has no lever",
        _RIG,
    ),
    _fault(
        "rig.py",
        "np.where(scene.is_unloading, 0.5, -0.5)",
        "np.where(scene.is_unloading, -0.5, 0.5)",
        "readings run ahead of a growing load",
        _RIG,
    ),
    _fault(
        "rig.py",
        "(_stated(experiment)[:, :2] / N_MM_PER_N_M) @ way",
        "(_stated(experiment)[:, :2] / (0.1 * N_MM_PER_N_M)) @ way",
        "shear is ten times what the truth says",
        _RIG,
    ),
    _fault(
        "rig.py",
        'for axis in ("VV", "IE") for towards in ("x", "z")]',
        'for axis in ("IE", "VV") for towards in ("x", "z")]',
        "the truth calls shear under varus that under internal moments",
        _RIG,
    ),
    _fault(
        "rig.py",
        "change[DISTRACTION] = -amplitude",
        "change[DISTRACTION] = amplitude",
        "compression pulls the bones apart",
        _RIG,
    ),
    _fault(
        "rig.py",
        "preload=experiment.preload + change)",
        "preload=experiment.preload)",
        "a constant load acts in no unloaded state",
        _RIG,
    ),
    _fault(
        "rig.py",
        "flexion_offset=float(np.radians(amplitude))",
        "flexion_offset=float(np.radians(-amplitude))",
        "a knee flexed more is flexed less",
        _RIG,
    ),
    _fault(
        "rig.py",
        "VARUS_SHARE = 0.4",
        "VARUS_SHARE = 1.0",
        "the varus loop is as wide as the internal one",
        _RIG,
    ),
    _fault(
        "rig.py",
        "np.log(scene.order)[:, None]",
        "np.asarray(scene.order)[:, None]",
        "creep grows with the number of trials, not with its logarithm",
        _RIG,
    ),
    _fault(
        "experiment.py",
        "energy.grood_suntay(np.ascontiguousarray(femur.T @ R @ tibia), femur.T @ t)",
        "energy.grood_suntay(np.ascontiguousarray(femur @ R @ tibia), femur @ t)",
        "a turned femoral frame is read as its inverse",
        _RIG,
    ),
    _fault(
        "experiment.py",
        "femur.T @ R @ tibia), femur.T @ t)",
        "femur.T @ R @ tibia.T), femur.T @ t)",
        "a turned tibial frame is read as its inverse",
        _RIG,
    ),
    _fault(
        "score.py",
        "NEAR_MM, NEAR_DEG = 10.0, 15.0",
        "NEAR_MM, NEAR_DEG = 60.0, 15.0",
        "a line on the other side of the knee counts as found",
        _SCORE,
    ),
    _fault(
        "score.py",
        "NEAR_MM, NEAR_DEG = 10.0, 15.0",
        "NEAR_MM, NEAR_DEG = 10.0, 60.0",
        "a line across the true one counts as found",
        _SCORE,
    ),
    _fault(
        "score.py",
        "and not (is_placed and len(named) == 1)",
        "and not is_placed",
        "a second, wrong name is forgiven",
        _SCORE,
    ),
    _fault(
        "structures.py",
        "[amplitude, amplitude * ratio]",
        "[amplitude * ratio, amplitude]",
        "the stiffer meniscus is on the other side than the truth says",
        _STRUCTURES,
    ),
    _fault(
        "structures.py",
        "N_MM_PER_N_M_DEG = 1000.0 * 180.0 / np.pi",
        "N_MM_PER_N_M_DEG = 1000.0 * np.pi / 180.0",
        "the rotational spring is softer by 3,300",
        _STRUCTURES,
    ),
    _fault(
        "structures.py",
        "line[LIFT], line[LIFT_SHARE] = -amplitude",
        "line[LIFT], line[LIFT_SHARE] = amplitude",
        "the medial collateral is pushed into the joint",
        _STRUCTURES,
    ),
    _fault(
        "hidden.py",
        "0.01 * strain_pct",
        "0.1 * strain_pct",
        "slack strains are ten times what the truth says",
        _STRUCTURES,
    ),
    _fault(
        "energy.py",
        "REFERENCE_DEPTH = 0.3",
        "REFERENCE_DEPTH = 3.0",
        "the modulus is that of another depth",
        _STRUCTURES,
    ),
    _fault(
        "fitting.py",
        "np.array([self.sd_mm] * 3 + [self.sd_deg] * 2)",
        "np.array([self.sd_mm] * 5)",
        "signals count degrees in millimetres' noise",
        _TRUTHS,
    ),
    _fault(
        "conditions.py",
        "self.shift_mm * way / np.linalg.norm(way)",
        "self.shift_mm * way / 3.0",
        "places lie at no distance in particular",
        _CONDITIONS,
    ),
    _fault(
        "conditions.py",
        "np.repeat([self.remount_mm, self.remount_deg], [3, 2])",
        "np.repeat([self.remount_mm, self.remount_deg], [2, 3])",
        "the third translation has the error of a rotation",
        _CONDITIONS,
    ),
)
