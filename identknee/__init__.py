"""Knee ligament calibrations, and how far they can be trusted.

The names below are the whole public interface, in the order of the flow: a subject, its laxity, the
model of it, the fit, the report. Each is loaded when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identknee.blind.case import BlindCase, blind_case
    from identknee.blind.folder import write_blind
    from identknee.blind.score import Score, score
    from identknee.blind.truth import Truth, read_truth
    from identknee.calibrate.bounded import with_bounds
    from identknee.calibrate.constrained import minimise, solve_constrained
    from identknee.calibrate.fit import Fit, fit, fit_many, waterfall
    from identknee.calibrate.problem import Problem
    from identknee.calibrate.quantity import ParameterQuantity, Quantity, UserQuantity
    from identknee.calibrate.starts import load_start
    from identknee.diagnosis.diagnose import Diagnosis, diagnose
    from identknee.identify.conformance.score import conformance_cases, run_conformance
    from identknee.identify.design.design import Design, design
    from identknee.identify.equivalents.equivalents import Equivalents, equivalents
    from identknee.identify.equivalents.region import Region, noise_region, power_of_best_test
    from identknee.identify.information.geodesic import Boundary, Geodesic, geodesics
    from identknee.identify.information.information import Information, information
    from identknee.identify.information.structure import Structure, StructureCheck, check_structure
    from identknee.identify.optimum import best_fit
    from identknee.identify.posterior.density import LogPosterior
    from identknee.identify.posterior.gate import SampleOutcome, StopRule
    from identknee.identify.posterior.nested import (
        NestedPosterior,
        nested_posterior,
        quantile_differences,
    )
    from identknee.identify.posterior.posterior import Posterior
    from identknee.identify.posterior.power_scaling import prior_sensitivity
    from identknee.identify.posterior.sample import Ensembles, sample
    from identknee.identify.profile.pairs import PairProfile, profile_pair
    from identknee.identify.profile.profiles import (
        other_optima,
        profile_parameters,
        profile_quantities,
    )
    from identknee.identify.profile.result import Profile, SideStatus, Verdict
    from identknee.identify.profile.thresholds import (
        bootstrap_statistics,
        chi2_threshold,
        f_threshold,
    )
    from identknee.identify.sensitivity.designs import Box, box_around
    from identknee.identify.sensitivity.sensitivity import Sensitivity, sensitivity
    from identknee.identify.sweep.cliffs import CliffMap, map_cliffs
    from identknee.identify.sweep.starts_design import distance, shell_starts, sobol_starts
    from identknee.identify.sweep.survey import Survey, survey
    from identknee.identify.sweep.sweep import Sweep, sweep
    from identknee.laxity.candidates import candidate_trials
    from identknee.laxity.examples import example_laxity
    from identknee.laxity.noise import add_noise
    from identknee.laxity.protocol import Protocol, load_protocol
    from identknee.laxity.rmse import LaxityError, laxity_rmse
    from identknee.laxity.table import Laxity, read_laxity, write_laxity
    from identknee.model.candidate_laxity import CandidateLaxity
    from identknee.model.effects.library import effect_named, library
    from identknee.model.effects.stored import effects_of
    from identknee.model.equivalence import rms_blocks
    from identknee.model.laxity_model import LaxityModel
    from identknee.model.laxity_outputs import LaxityOutputs
    from identknee.model.parameters import Parameters
    from identknee.model.prediction import Prediction
    from identknee.model.quantities import (
        LigamentForce,
        PredictedLaxity,
        ligament_forces,
        predicted_quantities,
        quantity_named,
    )
    from identknee.model.residuals import LaxityResiduals
    from identknee.model.simulate import Simulation, simulate
    from identknee.model.stability import StabilityReport, check_stability
    from identknee.report.scene import scene
    from identknee.runs.errors import InputError
    from identknee.runs.outcome import Outcome
    from identknee.subject.check import Finding, check_geometry
    from identknee.subject.folder import example, read_subject, write_subject
    from identknee.subject.frames import Frame
    from identknee.subject.knee import Knee
    from identknee.subject.ligament import Ligament
    from identknee.subject.opensim import import_opensim
    from identknee.subject.reference import reference_knee
    from identknee.subject.surface import Surface
    from identknee.verbs.profile import Profiles, profile

__all__ = [  # noqa: RUF022 - in the order of the flow
    "read_subject",
    "write_subject",
    "import_opensim",
    "reference_knee",
    "example",
    "Knee",
    "Surface",
    "Ligament",
    "Frame",
    "check_geometry",
    "Finding",
    "load_protocol",
    "Protocol",
    "read_laxity",
    "write_laxity",
    "example_laxity",
    "Laxity",
    "add_noise",
    "laxity_rmse",
    "LaxityError",
    "LaxityModel",
    "Parameters",
    "simulate",
    "Simulation",
    "Prediction",
    "check_stability",
    "StabilityReport",
    "LaxityResiduals",
    "Problem",
    "with_bounds",
    "load_start",
    "fit",
    "fit_many",
    "Fit",
    "waterfall",
    "sobol_starts",
    "shell_starts",
    "distance",
    "Sweep",
    "sweep",
    "Survey",
    "survey",
    "CliffMap",
    "map_cliffs",
    "Sensitivity",
    "sensitivity",
    "Box",
    "box_around",
    "LaxityOutputs",
    "Quantity",
    "ParameterQuantity",
    "UserQuantity",
    "best_fit",
    "chi2_threshold",
    "f_threshold",
    "bootstrap_statistics",
    "Profile",
    "Profiles",
    "SideStatus",
    "Verdict",
    "profile",
    "profile_parameters",
    "profile_quantities",
    "other_optima",
    "PairProfile",
    "profile_pair",
    "Posterior",
    "Ensembles",
    "sample",
    "StopRule",
    "SampleOutcome",
    "NestedPosterior",
    "nested_posterior",
    "quantile_differences",
    "prior_sensitivity",
    "LigamentForce",
    "PredictedLaxity",
    "ligament_forces",
    "predicted_quantities",
    "quantity_named",
    "Design",
    "design",
    "Information",
    "information",
    "Structure",
    "StructureCheck",
    "check_structure",
    "Boundary",
    "Geodesic",
    "geodesics",
    "CandidateLaxity",
    "candidate_trials",
    "Equivalents",
    "equivalents",
    "Region",
    "noise_region",
    "power_of_best_test",
    "rms_blocks",
    "minimise",
    "solve_constrained",
    "conformance_cases",
    "run_conformance",
    "LogPosterior",
    "blind_case",
    "BlindCase",
    "write_blind",
    "read_truth",
    "Truth",
    "score",
    "Score",
    "diagnose",
    "Diagnosis",
    "library",
    "effect_named",
    "effects_of",
    "scene",
    "Outcome",
    "InputError",
]

_MODULES = {
    "subject.folder": ("read_subject", "write_subject", "example"),
    "subject.opensim": ("import_opensim",),
    "subject.reference": ("reference_knee",),
    "subject.knee": ("Knee",),
    "subject.surface": ("Surface",),
    "subject.ligament": ("Ligament",),
    "subject.frames": ("Frame",),
    "subject.check": ("check_geometry", "Finding"),
    "laxity.protocol": ("load_protocol", "Protocol"),
    "laxity.table": ("read_laxity", "write_laxity", "Laxity"),
    "laxity.examples": ("example_laxity",),
    "laxity.noise": ("add_noise",),
    "laxity.rmse": ("laxity_rmse", "LaxityError"),
    "model.laxity_model": ("LaxityModel",),
    "model.parameters": ("Parameters",),
    "model.simulate": ("simulate", "Simulation"),
    "model.prediction": ("Prediction",),
    "model.stability": ("check_stability", "StabilityReport"),
    "model.residuals": ("LaxityResiduals",),
    "calibrate.problem": ("Problem",),
    "calibrate.bounded": ("with_bounds",),
    "calibrate.starts": ("load_start",),
    "calibrate.fit": ("fit", "fit_many", "Fit", "waterfall"),
    "identify.sweep.starts_design": (
        "sobol_starts",
        "shell_starts",
        "distance",
    ),
    "identify.sweep.sweep": (
        "Sweep",
        "sweep",
    ),
    "identify.sweep.survey": (
        "Survey",
        "survey",
    ),
    "identify.sweep.cliffs": (
        "CliffMap",
        "map_cliffs",
    ),
    "identify.sensitivity.sensitivity": (
        "Sensitivity",
        "sensitivity",
    ),
    "identify.sensitivity.designs": (
        "Box",
        "box_around",
    ),
    "model.laxity_outputs": ("LaxityOutputs",),
    "calibrate.quantity": (
        "Quantity",
        "ParameterQuantity",
        "UserQuantity",
    ),
    "identify.optimum": ("best_fit",),
    "identify.profile.thresholds": (
        "chi2_threshold",
        "f_threshold",
        "bootstrap_statistics",
    ),
    "identify.profile.result": ("Profile", "SideStatus", "Verdict"),
    "verbs.profile": ("Profiles", "profile"),
    "identify.profile.profiles": ("profile_parameters", "profile_quantities", "other_optima"),
    "identify.profile.pairs": (
        "PairProfile",
        "profile_pair",
    ),
    "identify.posterior.posterior": ("Posterior",),
    "identify.posterior.sample": (
        "Ensembles",
        "sample",
    ),
    "identify.posterior.gate": ("StopRule", "SampleOutcome"),
    "identify.posterior.nested": (
        "NestedPosterior",
        "nested_posterior",
        "quantile_differences",
    ),
    "identify.posterior.power_scaling": ("prior_sensitivity",),
    "model.quantities": (
        "LigamentForce",
        "PredictedLaxity",
        "ligament_forces",
        "predicted_quantities",
        "quantity_named",
    ),
    "identify.design.design": (
        "Design",
        "design",
    ),
    "identify.information.information": (
        "Information",
        "information",
    ),
    "identify.information.structure": (
        "Structure",
        "StructureCheck",
        "check_structure",
    ),
    "identify.information.geodesic": (
        "Boundary",
        "Geodesic",
        "geodesics",
    ),
    "model.candidate_laxity": ("CandidateLaxity",),
    "laxity.candidates": ("candidate_trials",),
    "identify.equivalents.equivalents": (
        "Equivalents",
        "equivalents",
    ),
    "identify.equivalents.region": (
        "Region",
        "noise_region",
        "power_of_best_test",
    ),
    "model.equivalence": ("rms_blocks",),
    "calibrate.constrained": (
        "minimise",
        "solve_constrained",
    ),
    "identify.conformance.score": (
        "conformance_cases",
        "run_conformance",
    ),
    "identify.posterior.density": ("LogPosterior",),
    "blind.case": (
        "blind_case",
        "BlindCase",
    ),
    "blind.folder": ("write_blind",),
    "blind.truth": (
        "read_truth",
        "Truth",
    ),
    "blind.score": (
        "score",
        "Score",
    ),
    "diagnosis.diagnose": (
        "diagnose",
        "Diagnosis",
    ),
    "model.effects.library": (
        "library",
        "effect_named",
    ),
    "model.effects.stored": ("effects_of",),
    "report.scene": ("scene",),
    "runs.outcome": ("Outcome",),
    "runs.errors": ("InputError",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


# Modules are loaded on first use so that `identknee --help` does not wait for compilers.
def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'identknee' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"identknee.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
