"""Faults of mechanics, laxity and effects: another knee than the one that was asked about."""

from mutation import Mutation

_SIZES = "tests/unit/model/effects/test_sizes.py"
_LOADS = "tests/unit/model/effects/test_load_effects.py"
_READINGS = "tests/unit/model/effects/test_reading_effects.py"
_LAWS = "tests/unit/mechanics/test_lines_and_laws.py"
_ENERGY = "tests/unit/mechanics/test_energy.py"
_GROOD = "tests/unit/mechanics/test_grood_suntay.py"
_NOISE = "tests/unit/laxity/test_noise.py"
_NUISANCES = "tests/unit/model/nuisances/test_nuisances.py"
_SHARED = "tests/unit/model/test_shared_errors.py"
_ESTIMATES = "tests/unit/identify/test_nuisance_estimates.py"


def _fault(file: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    return Mutation(file=f"identknee/{file}", old=old, new=new, why=why, tests=tests)


def _effect(file: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    return _fault(f"model/effects/{file}", old, new, why, *tests)


PRIORS = (
    _effect(
        "structures.py",
        "SITE_SD = 4.0",
        "SITE_SD = 12.0",
        "a structure may lie anywhere on the bone and still be called by its name",
        _SIZES,
    ),
    _effect(
        "placed.py",
        "CAPSULE_SITE_SD = 6.0",
        "CAPSULE_SITE_SD = 2.0",
        "the capsule is two threads instead of a sheet",
        _SIZES,
    ),
    _effect(
        "frames.py",
        "FRAME_SD, FRAME_LIMIT = 2.0",
        "FRAME_SD, FRAME_LIMIT = 8.0",
        "axes eight degrees wrong are usual, so that every misfit is one",
        _SIZES,
    ),
    _effect(
        "frames.py",
        '["flexion_deg"], [2.0]',
        '["flexion_deg"], [8.0]',
        "flexion eight degrees wrong is usual",
        _SIZES,
    ),
    _effect(
        "contact_law.py",
        "CARTILAGE_SD, NUMERICAL_SD = 0.7, 0.15",
        "CARTILAGE_SD, NUMERICAL_SD = 0.1, 0.15",
        "soft cartilage is impossible",
        _SIZES,
    ),
    _effect(
        "contact_law.py",
        "CARTILAGE_SD, NUMERICAL_SD = 0.7, 0.15",
        "CARTILAGE_SD, NUMERICAL_SD = 0.7, 0.6",
        "what a computation gets wrong of contact hides soft cartilage",
        _SIZES,
    ),
    _effect(
        "contact_law.py",
        "EXPONENT_SD = 0.3",
        "EXPONENT_SD = 0.05",
        "contact like that of a sphere is impossible",
        _SIZES,
    ),
    _effect(
        "placed.py",
        '"anterolateral": 1.2',
        '"anterolateral": 0.3',
        "an anterolateral ligament of published stiffness is impossible",
        _SIZES,
    ),
    _effect(
        "placed.py",
        '"posteromedial": 1.5',
        '"posteromedial": 6.0',
        "evidence punishes a posteromedial structure of published stiffness",
        _SIZES,
    ),
    _effect(
        "structures.py",
        "[self.stiffness_sd, 4.0]",
        "[self.stiffness_sd, 1.0]",
        "a structure as taut as a cruciate is impossible",
        _SIZES,
    ),
    _effect(
        "facts.py",
        '        "33 mm)",\n        relevant=0.2,',
        '        "33 mm)",\n        relevant=2.0,',
        "a structure of published stiffness is not worth knowing and its absence never shown",
        _SIZES,
    ),
    _effect(
        "facts.py",
        "relevant=10.0,",
        "relevant=100.0,",
        "100 N of compression are not worth knowing",
        _SIZES,
    ),
    _effect(
        "insertion.py",
        "SHIFT_SD, SHIFT_LIMIT = 2.0",
        "SHIFT_SD, SHIFT_LIMIT = 6.0",
        "insertions 6 mm off are usual",
        _SIZES,
    ),
    _effect("bundles.py", "5.0", "15.0", "bundles of one ligament have little in common", _SIZES),
    _effect(
        "wrapping.py",
        '["lift_mm"], [4.0]',
        '["lift_mm"], [1.0]',
        "a collateral pushed aside by 8 mm is impossible",
        _SIZES,
    ),
    _effect(
        "meniscus.py",
        "names, [20.0, 20.0]",
        "names, [2.0, 20.0]",
        "a medial meniscus of ordinary stiffness is impossible",
        _SIZES,
    ),
    _effect(
        "loads.py",
        '["force_N"], [60.0]',
        '["force_N"], [600.0]',
        "compression by body weight is usual in a rig",
        _SIZES,
    ),
    _effect(
        "loads.py", '["gain"], [0.1]', '["gain"], [0.5]', "moments half as large are usual", _SIZES
    ),
    _effect(
        "history.py",
        "[1.0, 1.0], lower",
        "[5.0, 1.0], lower",
        "loops five degrees wide are usual",
        _SIZES,
    ),
    _effect(
        "rig_compliance.py",
        '["compliance_deg_per_Nm"], [0.1]',
        '["compliance_deg_per_Nm"], [0.01]',
        "a boot is as stiff as pins in bone",
        _SIZES,
    ),
    _fault(
        "model/parameters.py",
        "np.full(n, 0.35), np.full(n, 2.0)",
        "np.full(n, 0.7), np.full(n, 2.0)",
        "the prior of the stiffness is twice as wide as README says",
        _SIZES,
    ),
    _fault(
        "model/parameters.py",
        "np.full(n, 0.35), np.full(n, 2.0)",
        "np.full(n, 0.35), np.full(n, 4.0)",
        "the prior of the reference strain is twice as wide as README says",
        _SIZES,
    ),
)
EFFECTS = (
    _effect(
        "loads.py",
        "acted[:, VARUS] += np.sin(internal_to_varus)",
        "acted[:, VARUS] -= np.sin(internal_to_varus)",
        "a misaligned axis is named with the wrong sign",
        _LOADS,
    ),
    _effect(
        "loads.py",
        "np.radians(values)\n    acted",
        "np.asarray(values)\n    acted",
        "degrees of misalignment are radians",
        _LOADS,
    ),
    _effect(
        "loads.py",
        "per = values.reshape(2, 2) / PER_NM",
        "per = values.reshape(2, 2)",
        "shear is a thousand times what its unit says",
        _LOADS,
    ),
    _effect(
        "loads.py",
        "np.outer(loads[:, INTERNAL], per[0]) + np.outer(loads[:, VARUS], per[1])",
        "np.outer(loads[:, INTERNAL], per[0]) - np.outer(loads[:, VARUS], per[1])",
        "shear under varus is named with the wrong sign",
        _LOADS,
    ),
    _effect(
        "loads.py",
        "acted[:, X] += -posterior * np.cos(flexion)",
        "acted[:, X] += posterior * np.cos(flexion)",
        "weight that pulls backwards is named as one that pulls forwards",
        _LOADS,
    ),
    _effect(
        "loads.py",
        "acted[:, INTERNAL] += PER_NM * values[0]",
        "acted[:, INTERNAL] -= PER_NM * values[0]",
        "a zero error is named with the wrong sign",
        _LOADS,
    ),
    _effect(
        "loads.py",
        "acted[:, VARUS] += PER_NM * values[1]",
        "acted[:, VARUS] += values[1]",
        "a zero error in N·m acts as one in N mm",
        _LOADS,
    ),
    _effect(
        "frames.py",
        'np.einsum("jin,jkn->ikn", femur, actual), tibia)',
        'np.einsum("ijn,jkn->ikn", femur, actual), tibia)',
        "a turned femoral frame is read as its inverse",
        _READINGS,
    ),
    _effect(
        "history.py",
        "(phase == UNLOADING).astype(float) - (phase == LOADING)",
        "(phase == LOADING).astype(float) - (phase == UNLOADING)",
        "loops run the other way",
        _READINGS,
    ),
    _effect(
        "history.py",
        "np.log(order - order.min() + 1.0)",
        "(order - order.min() + 1.0)",
        "creep grows with time, not with its logarithm",
        _READINGS,
    ),
)
MECHANICS = (
    _fault(
        "mechanics/elements.py",
        "elements[6, i] = k2 * (bend * gx * gx - felt * hxx)",
        "elements[6, i] = k2 * (steepness * gx * gx - felt * hxx)",
        "the stiffness of contact beside exponent 1 is wrong, and with it every sensitivity",
        f"{_LAWS}::test_the_stiffness_of_contact_is_the_slope_of_its_force",
    ),
    _fault(
        "mechanics/elements.py",
        "elements[11, i] = k2 * (bend * gy * gz - felt * hyz)",
        "elements[11, i] = k2 * (steepness * gy * gz - felt * hyz)",
        "the same of one of its mixed terms",
        f"{_LAWS}::test_the_stiffness_of_contact_is_the_slope_of_its_force",
    ),
    _fault(
        "mechanics/contact_law.py",
        "REFERENCE_DEPTH = 0.3",
        "REFERENCE_DEPTH = 0.6",
        "a change of the exponent is a change of the modulus too",
        f"{_LAWS}::test_the_exponent_leaves_the_pressure_at_three_tenths_alone",
    ),
    _fault(
        "mechanics/elements.py",
        "shape[4] += a - a * x * x",
        "shape[4] += a",
        "the stiffness of a wrapped ligament is wrong",
        f"{_LAWS}::test_a_line_bent_aside_has_the_slopes_of_its_length",
    ),
    _fault(
        "mechanics/elements.py",
        "shape[9] -= a * y * z",
        "shape[9] += a * y * z",
        "the same of one of its mixed terms",
        f"{_LAWS}::test_a_line_bent_aside_has_the_slopes_of_its_length",
    ),
    _fault(
        "mechanics/elements.py",
        "return depth, 1.0, depth * depth / (exponent + 1.0)\n        # What",
        "return depth, 1.0, depth * depth / 2.0\n        # What",
        "the energy beside exponent 1 is not that of the force",
        f"{_LAWS}::test_the_stiffness_of_contact_is_the_slope_of_its_force",
    ),
    _fault(
        "mechanics/elements.py",
        "return felt, reach / (2.0 * rounding),",
        "return felt, reach / (4.0 * rounding),",
        "the stiffness of contact that begins gradually is half of what it is",
        f"{_LAWS}::test_the_stiffness_of_contact_is_the_slope_of_its_force",
        "tests/unit/mechanics/test_contact_law.py",
    ),
    _fault(
        "mechanics/distance_field.py",
        "(bezier.min(axis=1) < MOST_ROUNDING)",
        "(bezier.min(axis=1) < 0.0)",
        "points that begin to bear before they touch are not looked at",
        "tests/unit/mechanics/test_contact_places.py",
        "tests/unit/mechanics/test_distance_field.py",
    ),
    _fault(
        "model/nuisances/library.py",
        "return MOST_ROUNDING if nuisances_of(knee) else knee.contact_rounding_mm",
        "return knee.contact_rounding_mm",
        "searches over uncertain geometry end at kinks",
        _NUISANCES,
    ),
    _fault(
        "verbs/fitted_knee.py",
        "replace(found, contact_rounding_mm=contact_rounding(stated))",
        "found",
        "a fitted knee does not predict what its fit did",
        "tests/unit/verbs/test_fitted_knee.py",
    ),
    _fault(
        "calibrate/curvature.py",
        "wanted = gradient - before.jacobian.T @ after.residuals",
        "wanted = change",
        "what Gauss and Newton know is counted twice",
        "tests/unit/calibrate/test_curvature.py",
    ),
    _fault(
        "calibrate/curvature.py",
        "sizes = np.abs(values)",
        "sizes = np.maximum(values, 0.0)",
        "where the misfit curves down a search does not move",
        "tests/unit/calibrate/test_curvature.py",
    ),
    _fault(
        "mechanics/ligament_law.py",
        "if strain <= 2.0 * transition:",
        "if strain <= 1.9 * transition:",
        "the force of every ligament leaps at the end of its toe",
        f"{_LAWS}::test_the_toe_ends_where_both_formulas_meet",
    ),
    _fault(
        "mechanics/ligament_wrench.py",
        "toe = stretched < 2.0 * width",
        "toe = stretched < 1.9 * width",
        "tensions in tables leap at the end of the toe",
        f"{_LAWS}::test_the_toe_ends_where_both_formulas_meet",
    ),
    _fault(
        "mechanics/ligament_law.py",
        "transition * transition / 6.0",
        "transition * transition / 3.0",
        "the energy leaps at the end of the toe, and steps are refused there",
        f"{_LAWS}::test_the_toe_ends_where_both_formulas_meet",
    ),
    _fault(
        "mechanics/energy.py",
        "by_strain = properties[i, 0] * slope * shape[0] / properties[i, 2]",
        "by_strain = properties[i, 0] * slope",
        "sensitivities to reference strain are wrong by the strain",
        f"{_ENERGY}::test_slopes_by_the_parameters_are_the_oracles",
    ),
    _fault(
        "mechanics/energy.py",
        "h[3] += sums[0] * axes[3, 1] - sums[1] * axes[3, 0]",
        "h[3] -= sums[0] * axes[3, 1] - sums[1] * axes[3, 0]",
        "what flexion does to the pose is wrong",
        f"{_ENERGY}::test_energy_gradient_hessian_and_flexion_slope_are_the_oracles",
    ),
    _fault(
        "mechanics/grood_suntay.py",
        "z - y * np.tan(varus),\n",
        "z + y * np.tan(varus),\n",
        "lateral shift has the wrong sign of what varus adds",
        _GROOD,
    ),
    _fault(
        "mechanics/grood_suntay.py",
        "            -y / np.cos(varus),\n",
        "            -y,\n",
        "distraction is along another axis than Grood and Suntay's",
        _GROOD,
    ),
    _fault(
        "mechanics/grood_suntay.py",
        "jacobian[..., 2, 0] = -y * secant * tangent",
        "jacobian[..., 2, 0] = y * secant * tangent",
        "the derivative of distraction by varus has the wrong sign",
        _GROOD,
    ),
    _fault(
        "mechanics/rims.py",
        "unique[count == 1]",
        "unique[count == 2]",
        "the rim of a sheet is its inside",
        "tests/unit/mechanics/test_rims.py",
    ),
    _fault(
        "laxity/noise.py",
        "scale = np.sqrt((student_degrees - 2) / student_degrees)",
        "scale = 1.0",
        "heavy-tailed noise is larger than stated",
        _NOISE,
    ),
    _fault(
        "laxity/noise.py",
        "sd[:, TRANSLATIONS], sd[:, ROTATIONS] = sd_mm, sd_deg",
        "sd[:, TRANSLATIONS], sd[:, ROTATIONS] = sd_deg, sd_mm",
        "translations have the noise of rotations",
        _NOISE,
    ),
)
NUISANCES = (
    _fault(
        "model/measured_frames.py",
        "return np.asarray((points - shifts[..., None, :]) @ turns)",
        "return np.asarray((points + shifts[..., None, :]) @ turns)",
        "a shift of the measured frames goes the other way",
        _NUISANCES,
    ),
    _fault(
        "mechanics/elements.py",
        "elements[first, k] = a * x + d * y + g * z",
        "elements[first, k] = a * x + b * y + c * z",
        "contact forces are turned into the measured frame the wrong way",
        _NUISANCES,
    ),
    _fault(
        "mechanics/contact_motion.py",
        "about @ (np.swapaxes(moment, 1, 2) - trace * np.eye(3))",
        "about @ (moment - trace * np.eye(3))",
        "slopes by the tibia's measured frame take its turns for the femur's",
        _NUISANCES,
    ),
    _fault(
        "model/gradient_change.py",
        "framed = replace(before, frames=settings[-1].frames)",
        "framed = before",
        "slopes of a structure that is added are those of a knee whose frames agree",
        _NUISANCES,
    ),
    _fault(
        "model/nuisances/geometry.py",
        "sds.append(float(np.sqrt(square)))",
        "sds.append(float(square))",
        "an insertion is as uncertain as its variance",
        _NUISANCES,
    ),
    _fault(
        "model/shared_errors.py",
        "    slopes = sd_deg * jacobian[:, :, -1]",
        "    slopes = jacobian[:, :, -1]",
        "flexion of a trial errs by one degree whatever is stated",
        _SHARED,
    ),
    _fault(
        "model/residuals.py",
        "covariance = np.eye(len(columns)) + columns @ columns.T",
        "covariance = np.eye(len(columns))",
        "shared errors are stated and not averaged over",
        _SHARED,
    ),
    _fault(
        "calibrate/problem.py",
        "return WithPriors(problem=without_priors(problem))",
        "return WithPriors(problem=problem)",
        "priors of nuisances count twice",
        _ESTIMATES,
    ),
    _fault(
        "identify/nuisances.py",
        "scatter = np.eye(len(places)) - covariance",
        "scatter = np.eye(len(places)) + covariance",
        "a nuisance beyond its prior is taken for probable",
        _ESTIMATES,
    ),
    _fault(
        "model/laxity_model.py",
        "centres = setting.frames.centres(centres)",
        "centres = 1.0 * centres",
        "rims are where the measured frames have them",
        _NUISANCES,
    ),
    _fault(
        "model/past_folds.py",
        "(found.codes[nodes] != CONVERGED)",
        "(found.codes[nodes] == CONVERGED)",
        "trials past the ends of their load paths stay lost",
        "tests/unit/model/test_past_folds.py",
    ),
    _fault(
        "verbs/barred.py",
        "return bool(cost > scale * chdtri(n_lost, 1.0 - LEVEL))",
        "return bool(cost > 0.0)",
        "a trial is left out wherever the others then fit a little better",
        "tests/unit/verbs/test_barred.py",
    ),
    _fault(
        "verbs/barred.py",
        "return ~np.isfinite(rise), at.theta",
        "return np.isnan(rise), at.theta",
        "a search stays before the trials that bar its way",
        "tests/unit/verbs/test_barred.py",
    ),
    _fault(
        "calibrate/least_squares.py",
        "if self._n_above_goal > self._creeping[0]:",
        "if self._n_above_goal < 0:",
        "searches creep along kinks until their budget is spent",
        "tests/unit/calibrate/test_least_squares.py",
    ),
    _fault(
        "calibrate/gauss_newton.py",
        "reduction <= max(KINK_SHARE * here.deviance, least)",
        "reduction <= KINK_SHARE * here.deviance",
        "searches over uncertain geometry end in a valley",
        "tests/unit/calibrate/test_least_squares.py",
    ),
    _fault(
        "subject/uncertainty.py",
        'number / 100.0 if unit == "%" else number',
        "number",
        "three per cent of load gain are three hundred",
        "tests/unit/subject/test_uncertainty.py",
    ),
    _fault(
        "blind/stated_errors.py",
        "turn = np.radians(conditions.registration_deg)",
        "turn = np.radians(0.1 * conditions.registration_deg)",
        "frames of blind knees are ten times better than stated",
        "tests/unit/blind/test_stated_errors.py",
    ),
)
FAULTS = (*PRIORS, *EFFECTS, *MECHANICS, *NUISANCES)
