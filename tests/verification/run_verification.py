"""Verify at length: ``python tests/verification/run_verification.py [--only ROW ...]``."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[2] / x) for x in ("tests", "tests/support", "studies")]

from requirement_rows import run

MODULES = {
    "derivatives": "verify_derivatives",
    "sensitivities": "verify_sensitivities",
    "mesh_law": "verify_mesh_law",
    "residual": "verify_residual",
    "outcomes": "verify_outcomes",
    "cold_warm": "verify_cold_warm",
    "recovery": "verify_recovery",
    "complex_regression": "verify_complex_regression",
    "points": "verify_points",
    "information": "verify_information",
    "conformance": "verify_conformance",
    "profile_ends": "verify_profile_ends",
    "ends_on_bounds": "verify_ends_on_bounds",
    "coverage": "verify_coverage",
    "edge_coverage": "verify_edge_coverage",
    "sbc": "verify_sbc",
    "nested": "verify_nested",
    "equivalents": "verify_equivalents",
    "kill": "verify_kill",
    "orphans": "verify_orphans",
    "fuzz": "verify_fuzz",
    "conventions": "verify_conventions",
    "rows": "verify_rows",
    "figures": "verify_figures",
    "blind": "verify_blind",
    "blind_axes": "verify_blind_axes",
    "blind_structures": "verify_blind_structures",
    "torn": "verify_verdicts",
    "constant_causes": "verify_verdicts",
    "two_causes": "verify_verdicts",
    "unlisted_causes": "verify_verdicts",
    "one_cause": "verify_verdicts",
    "measured_knee": "verify_measured_knee",
    "diagnosis_base": "verify_diagnosis_base",
    "measured_ends": "verify_measured_ends",
    "interval_pairs": "verify_interval_pairs",
    "priors": "verify_priors",
    "lowest_fit": "verify_lowest_fit",
    "experiments": "verify_experiments",
    "limits": "verify_limits",
    "sbc_limits": "verify_sbc_limits",
    "sbc_states": "verify_sbc_states",
    "forecast": "verify_forecast",
    "states": "verify_states",
    "blind_states": "verify_blind_states",
    "discrepancy": "verify_discrepancy",
    "opensim_cut": "verify_opensim_cut",
    "wrapping": "verify_wrapping",
    "uncertain": "verify_uncertain",
    "uncertain_diagnosis": "verify_uncertain_diagnosis",
}

if __name__ == "__main__":
    raise SystemExit(run("verification", MODULES, "tests/verification/run_verification.py"))
