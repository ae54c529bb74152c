"""Findings about a result, such as faults of its data, and the registry of their kinds."""

from collections.abc import Iterable, Mapping
from enum import Enum, unique
from typing import Any, TypeVar

from identknee.runs.declare import declared, entry
from identknee.runs.files import plain

MULTIPLY = "If these are metres, multiply by 1000."
DIVIDE = "If this is N per unit strain, divide by 1000."


@unique
class Severity(Enum):
    """How grave a finding is; the value is the word written to files."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"

    @property
    def prefix(self) -> str:
        """What stands before the sentence on a terminal; nothing before an info."""
        return _PREFIXES[self]


_PREFIXES = {Severity.INFO: "", Severity.WARNING: "Warning: ", Severity.ERROR: "Error: "}
INFO, WARNING, ERROR = Severity.INFO, Severity.WARNING, Severity.ERROR


@unique
class About(Enum):
    """What findings are about; the value is a heading."""

    DATA = "The table of measured laxity"
    FIT = "The fit"
    STARTS = "Searches and starts"
    TRIALS = "Trials"
    SUBJECT = "The subject under load"
    MODEL = "The model at the fit"
    CAUSES = "Causes of a diagnosis"
    GEOMETRY = "Geometry of a subject"
    EARLIER = "Stored by an earlier version"


@unique
class Doubt(Enum):
    """Why intervals at a fit do not count as knowledge; the value is written beside them."""

    MISFIT = "conditional on misfit"
    IMPLAUSIBLE = "at an implausible fit"
    CAUSE = "conditional on the cause"


@declared
class FindingKind:
    """What all findings of one code have in common."""

    code: str = entry("Stable identifier, written to ``result.json``")
    severity: Severity = entry("Severity unless the check states another one")
    about: About = entry("What findings of this kind are about: a heading of the list of codes")
    meaning: str = entry("What was found, as a sentence")
    remedy: str = entry(
        "What to do about it, as a sentence; none where nothing is to be done", default=""
    )
    template: str = entry(
        "The sentence, to be filled from the values; empty where the check writes it",
        default="",
    )
    lead: str = entry(
        "What precedes the template, which then has no full stop: on a page all findings with"
        " this lead become one sentence",
        default="",
    )
    distinct: tuple[str, ...] = entry(
        "Values that tell findings of this code about one place apart; of findings that agree"
        " in them a report shows one",
        default=(),
    )
    doubt: Doubt | None = entry(
        "Why nothing is known at a fit of which this was found: its results open with the finding; "
        "none for most",
        default=None,
    )
    invalidates: bool = entry(
        "Whether nothing could be computed, or nothing computed holds",
        default=False,
    )

    def sentence(self, *details: str) -> str:
        """The lead with the filled templates of one or several findings."""
        return f"{self.lead}{'; '.join(details)}." if self.lead else " ".join(details)


IMPLAUSIBLE = "Implausible at the fit: "
CHECK = "See: identknee subject check"


def _geometry(code: str, severity: Severity, meaning: str, remedy: str = "") -> FindingKind:
    return FindingKind(
        code=code,
        severity=severity,
        about=About.GEOMETRY,
        meaning=meaning,
        remedy=remedy,
    )


# In the order in which findings of one severity are listed: what explains others comes first.
_ALL = (
    FindingKind(
        code="coordinates-of-other-frames",
        severity=ERROR,
        about=About.DATA,
        meaning="At the measured poses half of the ligaments are far shorter than in the scan, so "
        "the coordinates are not those of this subject's frames.",
        remedy="If they are changes from a pose of the knee, say from which in a line of the "
        "table: # zero: unloaded, # zero: opposite, or # zero: and the name of a trial.",
        invalidates=True,
    ),
    FindingKind(
        code="broken-convention",
        severity=ERROR,
        about=About.DATA,
        meaning="One change of the table (a sign, a unit, the side, exchanged columns, the zero) "
        "removes nearly all of the misfit and leaves a plausible one.",
        remedy="Correct the table and repeat the command.",
        invalidates=True,
        distinct=("what",),
    ),
    FindingKind(
        code="moves-against-load",
        severity=ERROR,
        about=About.DATA,
        meaning="A coordinate falls as its load rises in most pairs of opposite loads, which no "
        "knee in stable equilibrium does.",
        remedy="Change the sign of one of the two columns, or exchange the columns that were "
        "swapped, and repeat the command.",
        invalidates=True,
        distinct=("coordinate",),
    ),
    FindingKind(
        code="translations-ambiguous",
        severity=WARNING,
        about=About.DATA,
        meaning="A table does not say how its translations are defined, and by another definition "
        "in use they would differ by more than the noise.",
        remedy="State the definition in a line of the table: # translations: components, or "
        "projections, femur or tibia.",
    ),
    FindingKind(
        code="angles-in-radians",
        severity=WARNING,
        about=About.DATA,
        meaning="An OpenSim storage does not state the unit of its angles, and was read in "
        "radians, as OpenSim reads it.",
        remedy="Write inDegrees=no above endheader, or inDegrees=yes if they are degrees.",
        template="No line inDegrees states the unit of angles: {columns} were read in radians, "
        "as OpenSim does. Write inDegrees=yes if they are degrees.",
        distinct=("columns",),
    ),
    FindingKind(
        code="angle-turned",
        severity=INFO,
        about=About.DATA,
        meaning="Angles had a jump of a whole turn, such as 358 deg beside 2 deg, and were read "
        "without it.",
        remedy="Correct the table if an angle was another one.",
        template="{n} values of {column} were read with a turn of 360 deg added or removed: the "
        "first, {given_deg:g} deg, as {read_deg:g} deg.",
        distinct=("column",),
    ),
    FindingKind(
        code="gap-as-number",
        severity=WARNING,
        about=About.DATA,
        meaning="Cells hold a number that often stands for a missing value and that no knee has: "
        "-99 among small values, or nothing but 0 under load.",
        remedy="Leave the cells blank if nothing was measured, or state the trial that others are "
        "counted from.",
        distinct=("number",),
    ),
    FindingKind(
        code="flexed-under-load",
        severity=INFO,
        about=About.DATA,
        meaning="A ramp of a time series is one of flexion under held loads, and was read at "
        "flexion angles.",
        remedy="State other angles in a line of the file, such as # angles: 0, 30, 60, 90.",
        template="In {ramp} the knee was flexed from {from_deg:.0f} to {to_deg:.0f} deg under held "
        "loads, so it was read at angles.",
        distinct=("ramp",),
    ),
    FindingKind(
        code="no-loads",
        severity=WARNING,
        about=About.DATA,
        meaning="No trial of the table has a load.",
        remedy="Check that the columns of loads are there.",
        template="No trial of the table has a load, so it contains almost no information about "
        "ligaments. "
        "Check that the columns of loads are there.",
    ),
    FindingKind(
        code="replicates-apart",
        severity=WARNING,
        about=About.DATA,
        meaning="Trials under equal loads differ by more than noise explains, as rows of several "
        "states of a knee in one table do.",
        remedy="Say in a column state which rows belong to which state, or give a table for each.",
    ),
    FindingKind(
        code="trial-against-course",
        severity=WARNING,
        about=About.DATA,
        meaning="A trial departs from the trend of the other trials over flexion, judged from the "
        "table alone.",
        remedy="Check the trial in the raw data: keep it with --keep if it is right.",
    ),
    FindingKind(
        code="trial-left-out",
        severity=INFO,
        about=About.DATA,
        meaning="A trial was left out because it was named in --leave-out.",
        remedy="Name fewer trials to have it in the result.",
        template="{trial} was left out, as asked.",
    ),
    FindingKind(
        code="trial-against-fit",
        severity=WARNING,
        about=About.DATA,
        meaning="A trial contradicts what a fit to all other trials predicts.",
        remedy="Check the trial in the raw data, and leave it out with --leave-out if it is wrong.",
    ),
    FindingKind(
        code="conditional-on-misfit",
        severity=WARNING,
        about=About.FIT,
        doubt=Doubt.MISFIT,
        meaning="The data and the priors of nuisances reject the best fit (p < 0.05), so that "
        "intervals hold only as far as that misfit does not matter.",
        remedy="Run identknee diagnose, and ask again with the cause that it names.",
        template="The model leaves more misfit than the noise: deviance {deviance:.4g} of {n} "
        "measured values, p = {p:.2g}. As long as it does, no interval holds and no value is "
        "known. Next: {command}",
    ),
    FindingKind(
        code="misfit-gross",
        severity=ERROR,
        about=About.FIT,
        doubt=Doubt.MISFIT,
        meaning="The best fit leaves more than nine times the misfit that noise of the stated size "
        "would: a mistake in the data, or something that the model lacks.",
        remedy="Check signs, units and side of the data, then run identknee diagnose.",
    ),
    FindingKind(
        code="misfit-improbable",
        severity=WARNING,
        about=About.FIT,
        doubt=Doubt.MISFIT,
        meaning="The best fit leaves more misfit than noise of the stated size would in one of a "
        "thousand tables.",
        remedy="Run identknee diagnose; uncertainties that are reported do not allow for it. Those "
        "with --discrepancy structures allow for structures that the model lacks.",
    ),
    FindingKind(
        code="error-large",
        severity=ERROR,
        about=About.FIT,
        doubt=Doubt.MISFIT,
        meaning="The data state no noise, and the best fit leaves more than the expected error of "
        "a laxity test (2 mm, 5 deg).",
        remedy="Check signs, units and side of the data, then run identknee diagnose.",
    ),
    FindingKind(
        code="noise-unstated",
        severity=INFO,
        about=About.FIT,
        meaning="The data state no noise, so the size of the error left cannot be judged.",
        remedy="Add sd_ columns, or give --noise.",
        template="The data state no noise, so whether the residuals are noise alone could not be "
        "judged. Add sd_ columns to judge it.",
    ),
    FindingKind(
        code="at-bound",
        severity=WARNING,
        about=About.FIT,
        meaning="Fitted parameters lie at a bound: the bound stopped the fit, not the data.",
        remedy="Widen the bound if values beyond it are possible; else read the other parameters "
        "as those of a knee whose parameter has the value of the bound.",
        distinct=("parameters",),
    ),
    FindingKind(
        code="too-few-values",
        severity=WARNING,
        about=About.FIT,
        meaning="Fewer values were measured than parameters are fitted.",
        remedy="Measure more trials, or fix parameters with --fix.",
    ),
    FindingKind(
        code="terms-disagree",
        severity=WARNING,
        about=About.FIT,
        meaning="Experiments, states or measured forces do not agree: each is fitted better alone "
        "than chance allows.",
        remedy="Look for a wrong state, rig or reading with identknee diagnose, or leave one out, "
        "as in --leave-out EXPERIMENT.",
        template="{terms} do not agree: fitted together their deviance is {difference:.3g} higher "
        "than fitted one by one (p = {p_value:.2g}), most of it in {worst} ({rise:.3g}).",
    ),
    FindingKind(
        code="nothing-fitted",
        severity=ERROR,
        about=About.STARTS,
        meaning="The search could not begin: there is no prediction at the start.",
        remedy="Choose another --start or other --bounds, or leave the cells of such trials blank.",
        invalidates=True,
    ),
    FindingKind(
        code="no-prediction",
        severity=ERROR,
        about=About.STARTS,
        meaning="No parameters near the start have a prediction in every measured trial.",
        remedy="Choose another --start, leave the cells of such trials blank, or run identknee "
        "subject check.",
        invalidates=True,
    ),
    FindingKind(
        code="no-set-converges",
        severity=ERROR,
        about=About.STARTS,
        meaning="No parameter set of a sensitivity analysis has an equilibrium in all trials.",
        remedy="Run identknee subject check.",
        template="no parameter set converges in all trials; see: identknee subject check",
        invalidates=True,
    ),
    FindingKind(
        code="starts-disagree",
        severity=WARNING,
        about=About.STARTS,
        meaning="Searches from different starts ended at other parameters, or at another misfit.",
        remedy="Run identknee sweep for the lowest misfit, and identknee profile for what the data "
        "leave open.",
        distinct=("parameters",),
    ),
    FindingKind(
        code="lowest-found-once",
        severity=WARNING,
        about=About.STARTS,
        meaning="Only one of several starts ended at the lowest misfit, so a lower one may exist.",
        remedy="Run identknee sweep.",
    ),
    FindingKind(
        code="trials-lost",
        severity=WARNING,
        about=About.TRIALS,
        meaning="The result does not rest on some measured trials, in which the model has no "
        "equilibrium.",
        remedy="Check these trials in the raw data, or state how well geometry is known with "
        "--uncertain.",
        distinct=("trials",),
    ),
    FindingKind(
        code="missing-restraint",
        severity=INFO,
        about=About.TRIALS,
        meaning="The forces that are missing at the measured poses of trials without equilibrium, "
        "and the structures that would supply them.",
        remedy="Add such a structure to the subject, for example a capsule, and fit again.",
        distinct=("trials",),
    ),
    FindingKind(
        code="trials-without-equilibrium",
        severity=INFO,
        about=About.TRIALS,
        meaning="Which trials have no equilibrium at the start, and how their search ended.",
        remedy="Choose another --start, or leave the cells of these trials blank.",
        distinct=("trials",),
    ),
    FindingKind(
        code="step-beyond-strength",
        severity=INFO,
        about=About.TRIALS,
        meaning="Steps that a design does not offer, since a ligament would carry more than the "
        "mean load at which such ligaments fail, and more than in trials that were made.",
        remedy="Offer such tests with smaller loads as --candidates.",
        distinct=("trials",),
    ),
    FindingKind(
        code="step-beyond-laxity",
        severity=INFO,
        about=About.TRIALS,
        meaning="Steps that a design does not offer, since the tibia would go farther from its "
        "unloaded pose than is assumed to be safe, and farther than in trials that were made.",
        remedy="Offer such tests with smaller loads as --candidates.",
        distinct=("trials",),
    ),
    FindingKind(
        code="unstable-subject",
        severity=WARNING,
        about=About.SUBJECT,
        meaning="At its own parameters the subject has no equilibrium in some trials of its data.",
        remedy="Run identknee subject check SUBJECT --protocol DATA.csv",
    ),
    FindingKind(
        code="hardly-stable-subject",
        severity=WARNING,
        about=About.SUBJECT,
        meaning="At its own parameters the subject is stable in all trials by a small margin only.",
        remedy="Run identknee subject check.",
    ),
    FindingKind(
        code="sets-without-prediction",
        severity=WARNING,
        about=About.MODEL,
        meaning="Parameter sets that the data allow have no prediction in some trial: limits near "
        "the fit are partly those of the model.",
        remedy="Run identknee subject check.",
        template="Of {n} parameter sets that would fit about as well as the best one, {n_lost} "
        "have no prediction in some trial: sets compatible with the data are missing here because "
        "the model has no equilibrium, not because the data exclude them. " + CHECK,
    ),
    FindingKind(
        code="contact-near-rim",
        severity=INFO,
        about=About.MODEL,
        meaning="Contact acts within 3 mm of where the cartilage surface ends.",
        remedy="Extend the surface if cartilage goes on beyond its rim.",
    ),
    FindingKind(
        code="implausible-force",
        severity=WARNING,
        about=About.MODEL,
        doubt=Doubt.IMPLAUSIBLE,
        meaning="A ligament carries more than twice the mean load at which such ligaments fail.",
        remedy="Do not use forces of this fit; run identknee diagnose.",
        lead=IMPLAUSIBLE,
        template="{ligament} carries {force_N:.0f} N under {load}, and such a ligament fails at "
        "{failure_N:.0f} N on average ({source})",
    ),
    FindingKind(
        code="implausible-strain",
        severity=WARNING,
        about=About.MODEL,
        doubt=Doubt.IMPLAUSIBLE,
        meaning="A ligament is strained beyond what ligament tissue withstands.",
        remedy="Do not use strains of this fit; run identknee diagnose.",
        lead=IMPLAUSIBLE,
        template="{ligament} is strained by {strain_pct:.0f} % under {load}, and ligaments fail at "
        "about {failure_pct:.0f} % ({source})",
    ),
    FindingKind(
        code="one-sided-contact",
        severity=WARNING,
        about=About.MODEL,
        doubt=Doubt.IMPLAUSIBLE,
        meaning="Without varus moment nearly all contact force acts in one compartment.",
        remedy="Do not use contact forces of this fit; check frames and registration.",
        lead=IMPLAUSIBLE,
        template="in trials without varus moment contact carries {medial_N:.0f} N medially and "
        "{lateral_N:.0f} N laterally under {compression_N:.0f} N of compression, in the middle of "
        "{n_trials} trials, which is contact on one side only ({source})",
    ),
    FindingKind(
        code="ligament-idle",
        severity=WARNING,
        about=About.MODEL,
        meaning="A ligament carries next to nothing, and by its prior it would carry a load in the "
        "same poses.",
        remedy="Do not quote its stiffness or its reference strain: check whether it is torn or "
        "absent. A torn, a slack and an absent one fit alike.",
        template="The {ligament} carries nothing in these trials (at most {force_N:.0f} N, by its "
        "prior {prior_force_N:.0f} N in the same poses): torn, slack or absent predict the same.",
    ),
    FindingKind(
        code="stiffness-scaled",
        severity=WARNING,
        about=About.MODEL,
        meaning="All ligaments are many times stiffer or more compliant than the subject states, "
        "as with loads in another unit.",
        remedy="Give moments in N·m and forces in N.",
        template="All ligaments are about {times:.2g} times {way} than the subject states: check "
        "that moments are in N·m and forces in N.",
    ),
    FindingKind(
        code="ligament-beyond-prior",
        severity=WARNING,
        about=About.MODEL,
        meaning="The data put a ligament that carries load far from its prior. That alone is no "
        "misfit.",
        remedy="Check what the prior rests on, and whether this knee was injured or operated on.",
        template="The data put the {ligament} far from its prior (p = {p_value:.2g}): "
        "{stiffness_kN:.2g} kN where {prior_stiffness_kN:.2g} kN was expected, and "
        "{strain_pct:.1f} % reference strain where {prior_strain_pct:.1f} % was.",
    ),
    FindingKind(
        code="nuisance-beyond-prior",
        severity=WARNING,
        about=About.MODEL,
        meaning="The fit moves a stated error (an insertion, a registration, a load) beyond its "
        "stated uncertainty.",
        remedy="State a larger uncertainty if it was too small; else run identknee diagnose for "
        "another cause.",
    ),
    FindingKind(
        code="fit-unfinished",
        severity=WARNING,
        about=About.CAUSES,
        meaning="A fit of the diagnosis stopped before its minimum, and a linear model promises a "
        "lower misfit.",
        remedy="Begin it elsewhere with --start.",
    ),
    FindingKind(
        code="cause-not-compared",
        severity=WARNING,
        about=About.CAUSES,
        meaning="A cause could not be compared with the others to the end, and why.",
        remedy="Read the verdict as one without this cause.",
    ),
    FindingKind(
        code="no-trial-advised",
        severity=INFO,
        about=About.CAUSES,
        meaning="No further trial can be advised that would tell the remaining causes apart.",
        remedy="Repeat the trials in which most misfit is left, or measure stated errors better.",
    ),
    _geometry(
        "in-metres", ERROR, "A length is so small or so large that it is not in mm.", MULTIPLY
    ),
    _geometry(
        "surfaces-same",
        ERROR,
        "Two of the three surfaces are the same, or one holds another.",
        "Give each surface its own file.",
    ),
    _geometry(
        "insertions-elsewhere",
        ERROR,
        "All insertions on a bone are far from its articular surface.",
        "Give insertions and surfaces in one frame, in mm: move those of a bone's own frame.",
    ),
    _geometry(
        "ligaments-exchanged",
        ERROR,
        "Insertions are on the other bone, a collateral ligament is on the other side, or the ACL "
        "inserts behind the PCL.",
        "Exchange the names of MCL and LCL, or mirror the insertions as the surfaces are.",
    ),
    _geometry(
        "ligaments-mirrored",
        ERROR,
        "Cruciates cross as in a knee of the other side.",
        "Mirror the insertions as the surfaces are: change the sign of one of their coordinates.",
    ),
    _geometry(
        "stiffness-impossible", ERROR, "No ligament has a stiffness near the stated one.", DIVIDE
    ),
    _geometry(
        "strain-impossible",
        ERROR,
        "No ligament has a reference strain near the stated one.",
        "Give the strain in the scanned pose in %, a few at most.",
    ),
    _geometry(
        "epicondyles-exchanged",
        ERROR,
        "The epicondyles are exchanged, so that the femur faces backwards.",
        "Exchange medial_epicondyle and lateral_epicondyle.",
    ),
    _geometry(
        "wrong-side",
        ERROR,
        "Plateaus or condyles lie as in a knee of the other side.",
        "State the other side if it is one; else exchange the files or landmarks, or correct axes.",
    ),
    _geometry(
        "normals-inward",
        ERROR,
        "The normals of a surface point into the bone where it faces the joint.",
        "Flip the normals of the surface (reverse its triangles), or correct the superior axis of "
        "the tibial frame.",
    ),
    _geometry(
        "trials-not-converging",
        ERROR,
        "At the subject's own parameters some trials of the protocol have no stable pose.",
        "Move the insertions that are named, run identknee subject settle, or correct the ligament "
        "parameters.",
    ),
    _geometry(
        "margin-low",
        WARNING,
        "All trials converge, some by a margin so small that a small change may lose them.",
        "Check the ligaments that hold this motion.",
    ),
    _geometry(
        "box-loses-trials",
        WARNING,
        "More than 1 % of the trials do not converge in a box around the subject's parameters.",
        "Expect cliffs when calibrating: start near, keep to narrower bounds, or move the "
        "insertions.",
    ),
    _geometry(
        "contact-points-coarse",
        WARNING,
        "The pose depends on whether the default contact points or all vertices are used, or the "
        "two cannot be compared.",
        "Smooth the cartilage surfaces, or use LaxityModel(n_points=None).",
    ),
    _geometry(
        "surface-repaired",
        WARNING,
        "A surface was mended when it was read.",
        "The mended surface is used, and identknee subject export writes it.",
    ),
    _geometry(
        "surface-closed",
        WARNING,
        "A surface is closed: it has a bone side as well.",
        "Keep the articular side only: force must keep growing with penetration.",
    ),
    _geometry(
        "surface-holes",
        WARNING,
        "A surface has holes within its rim, where it bears nothing.",
        "Fill the holes in the mesh, unless the cartilage is gone there.",
    ),
    _geometry(
        "winding-inconsistent",
        WARNING,
        "Neighbouring triangles of a surface face opposite ways.",
        "Make the winding consistent and all normals point outward.",
    ),
    _geometry(
        "edges-shared",
        WARNING,
        "Edges of a surface belong to more than two triangles.",
        "Remove inner or doubled sheets.",
    ),
    _geometry(
        "vertices-near-duplicate",
        WARNING,
        "Vertices of a surface nearly coincide.",
        "Merge vertices within a small tolerance.",
    ),
    _geometry(
        "triangles-degenerate",
        WARNING,
        "Triangles of a surface have hardly any area.",
        "Collapse them or remesh the surface.",
    ),
    _geometry(
        "surfaces-apart",
        WARNING,
        "In the scanned pose a tibial surface does not reach the femur.",
        "Use cartilage surfaces, not bone, and check that both bones are in one frame.",
    ),
    _geometry(
        "surfaces-overlap",
        WARNING,
        "In the scanned pose a tibial surface reaches deep into the femur.",
        "Check that both bones are in one frame and the pose is the scanned one.",
    ),
    _geometry(
        "ligament-length-odd",
        WARNING,
        "A ligament is shorter than 5 mm or longer than 200 mm in the scanned pose.",
        "Check its insertions: both are points of the common frame in mm.",
    ),
    _geometry(
        "insertion-far",
        WARNING,
        "An insertion is farther from the articular surface of its bone than any of a knee.",
        "Check its three numbers: they are a point of the common frame in mm.",
    ),
    _geometry(
        "insertion-inside-obstacle",
        WARNING,
        "An insertion lies inside the obstacle that its ligament wraps around.",
        "It counts as on the surface: correct the insertion, or the radius under wrap.",
    ),
    _geometry("stiffness-odd", WARNING, "A ligament's stiffness is unusually high.", DIVIDE),
    _geometry(
        "stiffness-zero",
        WARNING,
        "A ligament's stiffness is zero, so that it carries nothing.",
        "Give it a stiffness or remove it.",
    ),
    _geometry(
        "strains-as-fractions",
        WARNING,
        "All reference strains are so small that they may be fractions.",
        "If these are fractions, multiply by 100.",
    ),
    _geometry(
        "femur-size-odd",
        WARNING,
        "The femoral surface is not of the size of an articular surface.",
        "Check the units (cm, inch) and that it is the articular surface.",
    ),
    _geometry(
        "scanned-angle-odd",
        WARNING,
        "In the scanned pose the knee has an angle that no scanned knee has.",
        "Check that both frames have rows anterior, superior and to the subject's right.",
    ),
    _geometry(
        "origin-far",
        WARNING,
        "The origin of a frame is far away from the joint surface.",
        "Put the origin in the joint: forces act there, and translations are those of it.",
    ),
    _geometry(
        "axis-off-landmarks",
        WARNING,
        "An axis of a frame is not the one that the landmarks define.",
        "The frame is used; correct it or the landmarks.",
    ),
    _geometry(
        "all-converge", INFO, "All trials converge at the subject's own parameters, with margin."
    ),
    _geometry("box-converges", INFO, "Nearly all trials converge in a box around the parameters."),
    _geometry(
        "contact-points-enough", INFO, "The default contact points give the pose of all vertices."
    ),
    _geometry(
        "surface-contact", INFO, "How far a tibial surface is from the femur in the scanned pose."
    ),
)
KINDS = {x.code: x for x in _ALL}
RANKS = {code: place for place, code in enumerate(KINDS)}
# Of a result that an earlier version stored.
UNCODED = FindingKind(code="", severity=WARNING, about=About.EARLIER, meaning="Its words alone.")


@declared
class Finding:
    """A finding about a result.

    Terminal, ``result.json`` and report show the same findings. Checks make them with `finding`.
    """

    code: str = entry(
        "What kind of finding it is, from docs/findings.md; empty in results of earlier versions",
        default="",
    )
    severity: Severity = entry(
        "info explains; warning: conclusions may be wrong; error: the numbers must not be used "
        "before its cause is known"
    )
    sentence: str = entry("What was found and what can be done")
    where: str = entry(
        "What it is about: data, parameters, starts, subject, trials, or the name of a parameter, "
        "trial or cause"
    )
    values: Mapping[str, Any] = entry(
        "The numbers and names of the sentence by name, the last word of a name being its unit",
        default_factory=dict,
    )

    def __post_init__(self) -> None:
        if self.code and self.code not in KINDS:
            raise ValueError(f"there is no finding {self.code!r}; register it in findings.py")
        try:
            _ = self.detail
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):
            raise ValueError(f"the values do not fill the sentence of {self.code!r}") from None

    @property
    def kind(self) -> FindingKind:
        """What all findings of this code have in common."""
        return KINDS.get(self.code, UNCODED)

    @property
    def line(self) -> str:
        """As a terminal shows it."""
        return f"{self.severity.prefix}{self.sentence}"

    @property
    def detail(self) -> str:
        """The sentence without the lead of its kind, where it was filled into a template."""
        kind = self.kind
        return kind.template.format(**self.values) if kind.template else self.sentence

    @property
    def identity(self) -> tuple[Any, ...]:
        """Key that is equal for the same finding in two results, whatever its numbers."""
        if not self.code:
            return (self.severity, self.where, self.sentence)
        distinct = [self.values.get(x) for x in self.kind.distinct]
        return (self.code, self.severity, self.where, repr(distinct))


Found = TypeVar("Found", bound=Finding)


def finding(
    code: str,
    where: str,
    values: Mapping[str, Any] | None = None,
    *,
    sentence: str = "",
    severity: Severity | None = None,
) -> Finding:
    """A finding of a registered kind.

    Parameters
    ----------
    code
        Its kind.
    where
        What it is about.
    values
        Numbers and names of the sentence.
    sentence
        The sentence; left out where the kind has a template.
    severity
        How grave it is; as the kind has it where None.

    Raises
    ------
    ValueError
        If there is no such code.

    Examples
    --------
    >>> finding("no-loads", "data").line
    'Warning: No trial of the table has a load, so it contains almost no information about \
ligaments. Check that the columns of loads are there.'
    """
    kind = KINDS.get(code)
    if kind is None:
        raise ValueError(f"there is no finding {code!r}; register it in findings.py")
    given = plain(values or {}, keep_nonfinite=True)
    return Finding(
        code=code,
        severity=severity or kind.severity,
        sentence=sentence or kind.sentence(kind.template.format(**given)),
        where=where,
        values=given,
    )


def finding_lines(findings: Iterable[Finding]) -> list[str]:
    """What a terminal shows, the most severe first.

    Examples
    --------
    >>> about = finding("lowest-found-once", "starts", sentence="Only one start ended there.")
    >>> finding_lines([about, finding("no-set-converges", "trials")])[-1]
    'Warning: Only one start ended there.'
    """
    return [x.line for x in by_severity(findings)]


def by_severity(findings: Iterable[Found]) -> list[Found]:
    """The findings by severity, then as their kinds are listed, then in their order."""
    order = list(Severity)
    return sorted(findings, key=lambda x: (-order.index(x.severity), RANKS.get(x.code, len(RANKS))))


def without_repeats(findings: Iterable[Found]) -> tuple[Found, ...]:
    """The most severe first, each once."""
    kept: dict[tuple[Any, ...], Found] = {}
    for x in by_severity(findings):
        kept.setdefault(x.identity, x)
    return tuple(kept.values())


def doubt_of(findings: Iterable[Finding]) -> Doubt | None:
    """Why nothing is known at the fit of which these were found; None where nothing says so."""
    found = {x.kind.doubt for x in findings}
    return next((x for x in Doubt if x in found), None)


def invalidating(findings: Iterable[Finding]) -> str:
    """Why nothing was computed, or nothing computed holds; empty where no finding says so."""
    return next((x.sentence for x in findings if x.kind.invalidates), "")
