"""Whether unmeasured forces and strains of ligaments, and contact, are plausible."""

from collections.abc import Iterator

import numpy as np

from identknee.laxity.protocol import LOADS, dominant_loads
from identknee.laxity.trial_words import load_words
from identknee.mechanics.equilibria import TRANSITION_STRAIN
from identknee.model.laxity_model import LaxityModel, Prediction
from identknee.model.mechanics_inputs import PER_KN
from identknee.model.quantities import tensions_of
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, finding

# Mean load at which each fails [N]; lines whose names begin so are parts of it.
FAILURE_N = {
    "ACL": (2160.0, "Woo 1991, doi:10.1177/036354659101900303"),
    "PCL": (1878.0, "both bundles, Race 1994, doi:10.1016/0021-9290(94)90028-0"),
    "LCL": (295.0, "LaPrade 2005, doi:10.1177/0363546504274143"),
    "MCL": (557.0, "Wijdicks 2010, doi:10.1177/0363546510363465"),
    "sMCL": (557.0, "Wijdicks 2010, doi:10.1177/0363546510363465"),
    "dMCL": (101.0, "Wijdicks 2010, doi:10.1177/0363546510363465"),
}
# Specimens differ: twice the mean is beyond any, and no laxity test should come near the mean.
BEYOND = 2.0
# Ligament tissue fails at about this strain [%].
FAILURE_PCT, STRAIN_SOURCE = 15.0, "Butler 1986, doi:10.1016/0021-9290(86)90019-9"
# Balanced knees without varus moment press both compartments alike to within 67 N; one side alone
# with so much more [N] and less than such a share on the other is none.
APART_N, LEAST_SHARE = 400.0, 0.1
CONTACT_SOURCE = "balanced knees: within 67 N, Gustke 2014, doi:10.1016/j.arth.2013.10.020"
VARUS, DISTRACTION = LOADS.index("varus_moment_Nm"), LOADS.index("distraction_force_N")


def implausible_findings(model: LaxityModel, prediction: Prediction) -> tuple[Finding, ...]:
    """Forces, strains and contact of a fit that lie beyond published values of any knee.

    Trials without equilibrium are left out.

    Parameters
    ----------
    model, prediction
        The model and its prediction at the fit.
    """
    if not prediction.is_converged.any():
        return ()
    tension = tensions_of(model, prediction)
    return (
        *_forces(model, tension),
        *_strains(model, prediction, tension),
        *_contact(model, prediction),
    )


def _forces(model: LaxityModel, tension: Array) -> Iterator[Finding]:
    names = [x.name for x in model.knee.ligaments]
    for ligament, (failure, source) in FAILURE_N.items():
        own = [k for k, name in enumerate(names) if name.startswith(ligament)]
        whole = tension[:, own].sum(axis=1)
        if not own or np.nanmax(whole) <= BEYOND * failure:
            continue
        worst = int(np.nanargmax(whole))
        values = {
            "ligament": ligament,
            "force_N": whole[worst],
            "load": load_words(model.protocol, worst),
            "failure_N": failure,
            "source": source,
        }
        yield finding("implausible-force", ligament, values)


def _strains(model: LaxityModel, prediction: Prediction, tension: Array) -> Iterator[Finding]:
    """From the force, which has one strain where it is not zero."""
    u = model.tied.n
    stiffness = PER_KN * model.tied.stiffness(prediction.theta[:u])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = tension / stiffness
    strain = np.where(
        share > TRANSITION_STRAIN,
        share + TRANSITION_STRAIN,
        2.0 * np.sqrt(TRANSITION_STRAIN * share),
    )
    for k, ligament in enumerate(model.knee.ligaments):
        own = 100.0 * strain[:, k]
        if not np.isfinite(own).any() or np.nanmax(own) <= FAILURE_PCT:
            continue
        worst = int(np.nanargmax(own))
        values = {
            "ligament": ligament.name,
            "strain_pct": own[worst],
            "load": load_words(model.protocol, worst),
            "failure_pct": FAILURE_PCT,
            "source": STRAIN_SOURCE,
        }
        yield finding("implausible-strain", ligament.name, values)


def _contact(model: LaxityModel, prediction: Prediction) -> Iterator[Finding]:
    straight = prediction.is_converged & (dominant_loads(model.protocol).axis != VARUS)
    forces = prediction.centres[straight, :, 0]
    if not forces.size:
        return
    medial, lateral = np.median(forces, axis=0)
    if abs(medial - lateral) <= APART_N or min(medial, lateral) > LEAST_SHARE * (medial + lateral):
        return
    compression = -float(np.median(model.protocol.loads[straight, DISTRACTION]))
    values = {
        "medial_N": medial,
        "lateral_N": lateral,
        "compression_N": compression,
        "n_trials": int(straight.sum()),
        "source": CONTACT_SOURCE,
    }
    yield finding("one-sided-contact", "contact", values)
