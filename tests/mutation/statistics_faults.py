"""Faults of calibration, identification and diagnosis: numbers that look right and are not."""

from mutation import Mutation

_IDENTIFY = "tests/unit/identify/test_"
_DIAGNOSIS = "tests/unit/diagnosis/test_"


def _fault(file: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    return Mutation(file=f"identknee/{file}", old=old, new=new, why=why, tests=tests)


def _test(start: str, name: str) -> str:
    """A file by its name, or ``name::test`` for one test of it."""
    file, _, test = name.partition("::")
    return f"{start}{file}.py" + (f"::{test}" if test else "")


def _identify(file: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    paths = [_test(_IDENTIFY, x) for x in tests]
    return _fault(f"identify/{file}", old, new, why, *paths)


def _diagnosis(file: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    paths = [_test(_DIAGNOSIS, x) for x in tests]
    return _fault(f"diagnosis/{file}", old, new, why, *paths)


SURVIVED = (
    _identify(
        "posterior/chains.py",
        "max(_rhat(normal_scores(values)), _rhat(normal_scores(folded)))",
        "max(_rhat(values), _rhat(folded))",
        "ensembles at different places look alike where tails are heavy",
        "chains::test_rhat_sees_a_shift_of_heavy_tails_because_it_counts_ranks",
    ),
    _identify(
        "posterior/chains.py",
        "max(_rhat(normal_scores(values)), _rhat(normal_scores(folded)))",
        "_rhat(normal_scores(values))",
        "ensembles of different spread look alike",
        "chains::test_rhat_sees_heavy_tails_that_are_wider_by_folded_ranks",
    ),
    _identify(
        "sweep/basins.py",
        "TOLERANCE = 0.01",
        "TOLERANCE = 0.1",
        "two minima a fifth of a percent apart are one",
        "basins::test_ends_closer_than_a_fiftieth_of_a_percent_are_one_minimum",
    ),
    _identify(
        "sweep/basins.py",
        "TOLERANCE = 0.01",
        "TOLERANCE = 0.001",
        "one minimum found with rounding is two",
        "basins::test_ends_closer_than_a_fiftieth_of_a_percent_are_one_minimum",
    ),
    _identify(
        "sweep/basins.py",
        "BARRIER_SHARE, BARRIER_FLOOR = 1e-6, 2e-9",
        "BARRIER_SHARE, BARRIER_FLOOR = 1e-2, 2e-9",
        "a barrier of a thousandth of the objective is none",
        "basins::test_a_rise_of_a_thousandth_is_a_barrier_and_rounding_is_none",
    ),
    _identify(
        "sweep/basins.py",
        "BARRIER_SHARE, BARRIER_FLOOR = 1e-6, 2e-9",
        "BARRIER_SHARE, BARRIER_FLOOR = 1e-6, 1e-4",
        "minima that data without noise tell apart are one",
        "basins::test_a_rise_of_a_thousandth_is_a_barrier_and_rounding_is_none",
    ),
    _identify(
        "profile/thresholds.py",
        "return n_quantities * float(scipy.stats.f.ppf(level, n_quantities, degrees_of_freedom))",
        "return float(scipy.stats.f.ppf(level, n_quantities, degrees_of_freedom))",
        "regions of two parameters are half as large where the noise is estimated",
        "thresholds::test_two_quantities_at_once_have_twice_the_quantile_of_f",
    ),
    _identify(
        "profile/thresholds.py",
        "return n_quantities * float(scipy.stats.f.ppf(level, n_quantities, degrees_of_freedom))",
        "return n_quantities * float(scipy.stats.f.ppf(level, 1, degrees_of_freedom))",
        "regions of two parameters have the threshold of one, doubled",
        "thresholds::test_two_quantities_at_once_have_twice_the_quantile_of_f",
    ),
    _identify(
        "profile/thresholds.py",
        "law = scipy.stats.chi2(n_quantities)",
        "law = scipy.stats.chi2(1)",
        "regions of pairs at lower levels are too small",
        "thresholds::test_a_lower_level_keeps_the_proportion_of_the_law_of_as_many_quantities",
    ),
    _diagnosis(
        "score/score.py",
        "return (len(self.null) - below + 1) / (len(self.null) + 1)",
        "return (len(self.null) - below) / len(self.null)",
        "a simulated probability is zero",
        "score",
    ),
    _diagnosis(
        "score/localisation.py",
        "(above + 1) / (N_DRAWS + 1)",
        "above / N_DRAWS",
        "a simulated probability is zero",
        "localisation",
    ),
    _diagnosis(
        "missing_line/scan.py",
        "return float((1 + np.count_nonzero(highest >= self.scores.max())) / (1 + N_DRAWS))",
        "return float(np.count_nonzero(highest >= self.scores.max()) / N_DRAWS)",
        "a simulated probability is zero",
        "line_scan",
    ),
    _diagnosis(
        "score/signature.py",
        "wrong = (found * self.signature.sign[used] < 0).any(axis=1)",
        "wrong = (found * self.signature.sign[used] > 0).any(axis=1)",
        "structures that push explain what structures pull",
        "score::test_an_effect_of_one_sign_scores_on_its_own_side",
    ),
    _diagnosis(
        "explanations/candidates.py",
        "return np.asarray(positive.astype(np.int64) - negative.astype(np.int64))",
        "return np.asarray(negative.astype(np.int64) - positive.astype(np.int64))",
        "every structure is sought with a negative stiffness",
        "library_signatures::test_amplitudes_of_one_sign_are_those_that_cannot_be_negative",
    ),
    _diagnosis(
        "explanations/candidates.py",
        "return np.asarray(positive.astype(np.int64) - negative.astype(np.int64))",
        "return np.zeros(parameters.n, np.int64)",
        "structures may push",
        "library_signatures::test_amplitudes_of_one_sign_are_those_that_cannot_be_negative",
    ),
    _diagnosis(
        "explanations/candidates.py",
        "moved = -np.linalg.solve(prediction.hessians, gradients)",
        "moved = np.linalg.solve(prediction.hessians, gradients)",
        "structures are sought by the opposite of what they do",
        "library_signatures::test_a_signature_is_what_the_effect_does_to_the_predictions",
    ),
    _diagnosis(
        "gain/held_out.py",
        "MOST_STEPS = 12",
        "MOST_STEPS = 1",
        "the error on held-out trials is that of a fit that has hardly begun",
        "held_out::test_a_fold_is_fitted_to_the_end_and_not_by_one_step",
    ),
)
IDENTIFICATION = (
    _identify(
        "profile/thresholds.py",
        "return float(scipy.stats.chi2.ppf(level, n_quantities))",
        "return float(scipy.stats.chi2.ppf(level, 1))",
        "regions of two parameters are those of one",
        "thresholds::test_one_quantity_and_two",
    ),
    _identify(
        "profile/thresholds.py",
        "places = (np.ceil(n * level) - 1, law.ppf(tail) - 1",
        "places = (np.ceil(n * level) - 3, law.ppf(tail) - 1",
        "simulated thresholds are the third lower statistic",
        "thresholds::test_data_sets_without_a_fit_are_counted_and_left_out",
    ),
    _identify(
        "profile/hermite.py",
        "+ u**2 * (u - 1) * width * slope_g",
        "- u**2 * (u - 1) * width * slope_g",
        "ends between points of a profile are in the wrong place",
        "hermite::test_a_cubic_is_its_own_curve",
    ),
    _identify(
        "posterior/moves.py",
        "correction = mixture.log_density(state.coords[moving]) - mixture.log_density(proposed)",
        "correction = mixture.log_density(proposed) - mixture.log_density(state.coords[moving])",
        "the sample is of another density",
        "moves::test_moments_are_those_of_the_density",
    ),
    _identify(
        "posterior/moves.py",
        "- 0.5 * (degrees + n) * np.log1p(squares / degrees)",
        "- 0.5 * degrees * np.log1p(squares / degrees)",
        "the proposals' density is not the one they are drawn from",
        "moves::test_the_mixture_has_the_density_it_draws_from",
    ),
    _identify(
        "posterior/moves.py",
        "(sample.shape[1] - 1) * np.log(new_length / length)",
        "sample.shape[1] * np.log(new_length / length)",
        "snooker steps sample another density",
        "moves::test_moments_are_those_of_the_density",
    ),
    _identify(
        "posterior/density.py",
        "- np.sum(working[..., parameters.is_log], axis=-1)",
        "+ 0.0 * np.sum(working[..., parameters.is_log], axis=-1)",
        "the density of lognormal parameters lacks its Jacobian",
        "posterior::test_the_prior_has_mass_one_within_the_bounds",
    ),
    _identify(
        "posterior/density.py",
        "center = working - np.linalg.solve(information, gradient)",
        "center = working + np.linalg.solve(information, gradient)",
        "proposals go away from the optimum",
        "posterior::test_the_kernel_of_a_linear_problem_is_its_posterior",
    ),
    _identify(
        "posterior/chains.py",
        "return np.asarray(norm.ppf((ranks - 0.375) / (values.size + 0.25)))",
        "return np.asarray(norm.ppf((ranks - 0.5) / (values.size + 0.25)))",
        "ranks are not those of Blom, and R-hat is not that of the literature",
        "chains::test_rhat_sees_a_shift_of_heavy_tails_because_it_counts_ranks",
        "chains::test_scores_of_ranks_are_those_of_blom",
    ),
    _identify(
        "posterior/chains.py",
        "sums = 2.0 * np.cumsum(autocorrelation(values)) - 1.0",
        "sums = np.cumsum(autocorrelation(values))",
        "samples look twice as good as they are",
        "chains::test_autocorrelation_time_of_a_known_sequence",
    ),
    _identify(
        "sensitivity/estimators.py",
        '"S1": np.stack([share(b * (mixed[:, i] - a))',
        '"S1": np.stack([share(a * (mixed[:, i] - a))',
        "first-order Sobol indices are another quantity",
        "sensitivity_estimators",
    ),
    _identify(
        "sensitivity/estimators.py",
        "share(0.5 * (a - mixed[:, i]) ** 2)",
        "share((a - mixed[:, i]) ** 2)",
        "total Sobol indices are twice as large",
        "sensitivity_estimators",
    ),
    _identify(
        "sensitivity/estimators.py",
        "weight / np.maximum(weight - 1.0, 1.0)",
        "1.0",
        "the spread of elementary effects is biased",
        "sensitivity_estimators",
    ),
    _identify(
        "sensitivity/estimators.py",
        "change = np.diff(outputs, axis=1) / sizes",
        "change = np.diff(outputs, axis=1) / np.abs(sizes)",
        "mean elementary effects lose their sign",
        "sensitivity_estimators",
    ),
    _identify(
        "design/criteria.py",
        "return np.asarray(-np.log(eigenvalues).sum(axis=1))",
        "return np.asarray(np.log(eigenvalues).sum(axis=1))",
        "D-optimality chooses the worst trials",
        "design::test_losses_are_those_of_their_names",
    ),
    _identify(
        "design/criteria.py",
        "return np.asarray(1.0 / eigenvalues[:, 0])",
        "return np.asarray(1.0 / eigenvalues[:, -1])",
        "E-optimality looks after what is known best",
        "design::test_losses_are_those_of_their_names",
    ),
    _identify(
        "design/criteria.py",
        "intervals.append(path.ends(rise - saved))",
        "intervals.append(path.ends(rise))",
        "predicted widths are too small: other parameters give way for nothing",
        "design::test_an_open_interval_is_closed_as_predicted",
        "design::test_on_a_linear_model_predicted_is_achieved_is_the_formula",
    ),
    _identify(
        "equivalents/region.py",
        "return float(norm.sf(norm.isf(LEVEL) - np.sqrt(squared_distance)))",
        "return float(norm.sf(norm.isf(LEVEL) - squared_distance))",
        "the power to tell two parameter sets apart is that of another distance",
        "equivalents::test_power_grows_with_the_distance_and_not_with_its_square",
    ),
    _identify(
        "equivalents/region.py",
        "/ np.sqrt(region.limit)",
        "/ region.limit",
        "the region of equivalent sets has another limit than asked for",
        "equivalents_extremum::test_an_extremum_is_the_end_of_a_profile",
        "equivalents::test_an_ellipsoid_has_its_known_extents_and_diameter",
    ),
    _identify(
        "information/geodesic.py",
        "bending = -right.T @ (damped * (left.T @ second))",
        "bending = right.T @ (damped * (left.T @ second))",
        "geodesics bend the wrong way and end at other boundaries",
        "geodesic::test_on_a_sphere_they_are_great_circles",
    ),
    _identify(
        "sensitivity/designs.py",
        "STIFFNESS_SHARE * np.abs(center)",
        "STIFFNESS_SHARE",
        "the box of stiffnesses is a fraction of a kN wide",
        "sensitivity::test_the_usual_box",
    ),
    _fault(
        "calibrate/complex.py",
        "REFLECTION = 0.9",
        "REFLECTION = 1.3",
        "Complex is not the paper's",
        "tests/unit/calibrate/test_complex.py",
    ),
    _fault(
        "calibrate/complex.py",
        "np.delete(self.population, self._worst, axis=0).mean(axis=0)",
        "self.population.mean(axis=0)",
        "the centroid counts the worst candidate",
        "tests/unit/calibrate/test_complex.py",
    ),
    _fault(
        "runs/store.py",
        'return digest(f"{key} {text}"',
        'return digest(f"{key}"',
        "a damaged result of an interrupted run is taken for whole",
        "tests/unit/runs/test_store.py",
    ),
    _fault(
        "runs/resume.py",
        "elif json.dumps(before) != json.dumps(now):",
        "elif False and json.dumps(before) != json.dumps(now):",
        "a run goes on with results of other settings",
        "tests/unit/runs/test_resume.py",
    ),
    _fault(
        "runs/resume.py",
        "return [results[key] for key in keys]",
        "return [results[key] for key in sorted(keys)]",
        "results of more than ten items stand in another order",
        "tests/unit/runs/test_resume.py",
    ),
    _fault(
        "model/residuals.py",
        "return self.weighted(-self._difference(prediction.coordinates))",
        "return self.weighted(self._difference(prediction.coordinates))",
        "residuals have the other sign than their derivatives",
        "tests/unit/model/test_residuals.py",
    ),
    _fault(
        "verbs/averaged.py",
        "offset=slopes @ (everything.center - theta)[varied],",
        "offset=slopes @ (theta - everything.center)[varied],",
        "errors averaged over move predictions away from the middle of their priors",
        "tests/unit/verbs/test_averaged.py",
    ),
    _fault(
        "identify/design/better_known.py",
        "np.sqrt(SHARE**-2 - 1.0)",
        "np.sqrt(SHARE**-2)",
        "an error known twice as well narrows too much",
        "tests/unit/identify/test_design.py",
    ),
)
DIAGNOSIS = (
    _diagnosis(
        "score/misfit.py",
        "degrees = squares**3 / cubes**2",
        "degrees = mean**2 / squares",
        "probabilities of weighted sums are those of two moments only",
        "tails::test_weighted_tail_is_that_of_simulation",
    ),
    _diagnosis(
        "score/misfit.py",
        "mean = float(np.mean(1 / np.tan(np.pi * used)))",
        "mean = float(np.max(1 / np.tan(np.pi * used)))",
        "several tests together alarm too often",
        "goodness::test_a_small_probability_among_several_counts_as_often_as_was_looked",
    ),
    _diagnosis(
        "score/misfit.py",
        "p_value = float(stats.f.sf(ratio, degrees, noise_degrees))",
        "p_value = float(stats.chi2.sf(square, degrees))",
        "an estimated noise counts as known",
        "goodness::test_noise_estimated_from_few_values_alarms_as_often_as_stated",
    ),
    _diagnosis(
        "noise/noise_model.py",
        "spread = nuisance * nuisance_sd\n",
        "spread = nuisance * nuisance_sd**2\n",
        "nuisances have the square of their spread",
        "noise_model::test_nuisances_in_the_covariance_are_nuisances_fitted_with_their_prior",
    ),
    _diagnosis(
        "explanations/causes.py",
        "- np.log(np.diag(information[0])).sum()",
        "+ np.log(np.diag(information[0])).sum()",
        "evidence prefers flexible causes",
        "laplace::test_without_bounds_it_is_the_evidence_of_a_linear_model",
    ),
    _diagnosis(
        "explanations/causes.py",
        "- prior_mass.sum()",
        "+ prior_mass.sum()",
        "half-normal priors count for half instead of double",
        "laplace::test_one_bound_is_exact",
    ),
    _diagnosis(
        "gain/gain.py",
        "[y.log_density - x.log_density for x, y in pairs]",
        "[x.log_density - y.log_density for x, y in pairs]",
        "the worse model is called the better one",
        "held_out::test_the_difference_of_two_models_is_the_sum_over_trials",
    ),
    _diagnosis(
        "gain/gain.py",
        "np.sqrt(n * np.var(by_trial, ddof=1))",
        "np.sqrt(np.var(by_trial, ddof=1))",
        "a gain of prediction is called certain",
        "held_out::test_the_difference_of_two_models_is_the_sum_over_trials",
    ),
    _diagnosis(
        "score/score.py",
        "is_powerful = power >= HIGH_POWER",
        "is_powerful = power <= HIGH_POWER",
        "what lacked power is called excluded",
        "power::test_silence_means_something_only_where_the_test_has_power",
    ),
    _diagnosis(
        "score/score.py",
        "factors = LEVEL / np.exp(log_tail_of_z_score(quantiles))",
        "factors = np.exp(log_tail_of_z_score(quantiles)) / LEVEL",
        "many sites of one structure are as many chances to be named",
        "score::test_variants_count_as_the_looks_they_are_worth",
    ),
    _diagnosis(
        "score/misfit.py",
        "LEAST_SINGULAR_VALUE = 1e-6",
        "LEAST_SINGULAR_VALUE = 1e-1",
        "sloppy directions of the fit pass for causes",
        "projection",
    ),
    _diagnosis(
        "score/localisation.py",
        "expected = without.rank - projector.rank",
        "expected = 0",
        "noise counts as explained misfit",
        "localisation::test_the_share_is_what_falls_when_the_data_are_left_out",
    ),
    _diagnosis(
        "gain/held_out.py",
        "left = -(at.residuals[held] - weights @ at.residuals[kept])",
        "left = -at.residuals[held]",
        "errors shared between trials tell nothing of held ones",
        "held_out::test_the_prediction_of_a_linear_model_is_exact",
    ),
)
NAMING = (
    _diagnosis(
        "explanations/attribution.py",
        "return fall > least and new.log_evidence > old.log_evidence + LEAST_GAIN",
        "return fall > least or new.log_evidence > old.log_evidence + LEAST_GAIN",
        "a cause joins whatever its prior says",
        "attribution::test_a_first_cause_must_lower_the_misfit_and_gain_evidence",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "LEAST_FALL, FURTHER_FALL = 9.0, 16.0",
        "LEAST_FALL, FURTHER_FALL = 9.0, 9.0",
        "second causes are named where the first is only nearly right",
        "attribution::test_a_further_cause_must_lower_it_by_more",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "LEAST_FALL, FURTHER_FALL = 9.0, 16.0",
        "LEAST_FALL, FURTHER_FALL = 4.0, 16.0",
        "a cause is named for what chance does",
        "attribution::test_a_first_cause_must_lower_the_misfit_and_gain_evidence",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "enough = [x for x in simpler if not _is_better(current, x)]",
        "enough = [x for x in simpler if _is_better(current, x)]",
        "causes that are needed are left out, and stand-ins stay",
        "attribution::test_a_cause_that_another_made_superfluous_is_left_out",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "return last.at is self.best and last.is_significant",
        "return last.is_significant",
        "what the best explanation explains counts as unexplained",
        "attribution::test_what_the_best_explanation_explains_is_not_left_unexplained",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "MOST_CAUSES = 3",
        "MOST_CAUSES = 2",
        "three causes are never found together",
        "attribution::test_no_more_than_three_causes_are_sought",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "best = max([current, *flexible], key=lambda x: x.log_evidence)",
        "best = min([current, *flexible], key=lambda x: x.log_evidence)",
        "effects that fit anything win where they are worst",
        "attribution::test_an_effect_of_many_amplitudes_wins_by_evidence_alone",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "(FURTHER_LEVEL if self.at.causes else LEVEL)",
        "(LEVEL if self.at.causes else FURTHER_LEVEL)",
        "first causes are missed and further ones invented",
        "attribution::test_a_further_cause_needs_a_rarer_score_than_the_first",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "tuple(sorted(found, key=lambda x: -x.log_evidence))",
        "tuple(sorted(found, key=lambda x: x.log_evidence))",
        "the worst explanation is named",
        "attribution",
    ),
    _diagnosis(
        "explanations/attribution.py",
        "LEAST_SCORE = 1.0",
        "LEAST_SCORE = -1.0",
        "effects that score nothing are refitted",
        "attribution",
    ),
    _diagnosis(
        "explanations/refit.py",
        "log_evidence_deficit=best.log_evidence - other.log_evidence",
        "log_evidence_deficit=other.log_evidence - best.log_evidence",
        "no rival is ever excluded",
        "attribution",
    ),
    _diagnosis(
        "explanations/refit.py",
        "if set(x.names) != set(best.names):",
        "if x is not best:",
        "the best explanation is its own rival, and nothing is named",
        "attribution::test_another_fit_of_the_same_causes_is_no_rival",
    ),
    _diagnosis(
        "explanations/refit.py",
        "- np.log(p.prior_sd).sum()",
        "+ np.log(p.prior_sd).sum()",
        "evidence prefers causes whose priors are wide",
        "attribution::test_evidence_is_the_probability_of_the_data_up_to_a_constant",
    ),
    _diagnosis(
        "explanations/refit.py",
        "+ halves * np.log(2.0)",
        "- halves * np.log(2.0)",
        "evidence punishes causes of one sign four times over",
        "attribution::test_evidence_is_the_probability_of_the_data_up_to_a_constant",
    ),
)
FAULTS = (*SURVIVED, *IDENTIFICATION, *DIAGNOSIS, *NAMING)
