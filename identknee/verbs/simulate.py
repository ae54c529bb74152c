"""The laxity of a knee under a protocol, and how each trial ended."""

from dataclasses import replace
from typing import Annotated, Any, Unpack

from typing_extensions import override

from identknee.calibrate.fit import StartLike, load_start
from identknee.checks.subject_checks import rim_findings
from identknee.checks.usable_trials import path_findings
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import (
    Laxity,
    LaxityError,
    TrialsLike,
    add_noise,
    laxity_rmse,
    read_tests,
    write_laxity,
)
from identknee.laxity.translations import COMPONENTS, Translations
from identknee.mechanics.equilibria import Continuation
from identknee.model.candidate_laxity import continued_from_own_poses
from identknee.model.laxity_model import Contact, LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction
from identknee.runs.declare import (
    OF_COORDINATE,
    OF_PARAMETER,
    Array,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.record import Outcome
from identknee.verbs import options
from identknee.verbs.answer import Answer
from identknee.verbs.options import option
from identknee.verbs.values import (
    NoiseLike,
    ValuesLike,
    by_ligament,
    noise_of,
    values_of,
)
from identknee.verbs.verb import Run, verb, warm_up

LAXITY_FILE = "laxity.csv"


@declared
class TrialEnd:
    """How a simulated trial ended."""

    trial: str = entry("Name of the trial")
    outcome: Outcome = entry("How the trial ended")
    reason: str = entry("How the trial ended, as a sentence")
    margin_N_per_mm: float = entry(  # noqa: N815 - the unit
        "Smallest eigenvalue of the stiffness; null without a pose or for mesh contact", unit="N/mm"
    )
    rim_share: float = entry(
        "Share of the contact force within 3 mm of a rim; null for mesh contact", unit="1"
    )


@declared
class SimulatedLaxity(Answer):
    """What a model predicts with one parameter set."""

    subject: str = entry("Name of the subject")
    protocol: Protocol = entry("The trials", group="constant_data")
    trials: tuple[TrialEnd, ...] = entry("How each trial ended", rows="trial", group="predictions")
    coordinates: Array = array(
        "Predicted coordinates; NaN where a trial did not converge",
        *("trial", "coordinate"),
        unit=OF_COORDINATE,
        group="predictions",
    )
    tension_N: Array = array(  # noqa: N815 - the unit
        "Tension of each ligament; NaN where a trial did not converge",
        *("trial", "ligament"),
        unit="N",
        group="predictions",
    )
    ligaments: tuple[str, ...] = array("Names of the ligaments", "ligament", is_in_arrays=False)
    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    theta: Array = array(
        "Parameters simulated with", "parameter", unit=OF_PARAMETER, group="predictions"
    )

    @property
    def laxity(self) -> Laxity:
        """The predicted laxity table; trials that did not converge are blank."""
        return Laxity(protocol=self.protocol, coordinates=self.coordinates)

    @property
    @override
    def parameter_set(self) -> dict[str, float]:
        """The parameters simulated with, by name."""
        return dict(zip(self.parameter_names, self.theta.tolist(), strict=True))

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """How each trial ended."""
        return tuple(x.outcome for x in self.trials)

    @property
    @derived("Number of trials", unit="1")
    def n_trials(self) -> int:
        return self.protocol.n

    @property
    @derived("Number of trials with an equilibrium", unit="1")
    def n_converged(self) -> int:
        return sum(x is Outcome.CONVERGED for x in self.outcomes)

    @property
    @derived("Parameters simulated with, by ligament and quantity", unit=OF_PARAMETER)
    def parameters(self) -> dict[str, dict[str, float]]:
        return by_ligament(self.parameter_set)


@declared
class Simulation(SimulatedLaxity):
    """The laxity of a knee under a protocol, and how each trial ended."""

    noisy: Laxity | None = entry(
        "The laxity with noise added", group="observed_data", only="`--noise`", default=None
    )
    rmse: LaxityError | None = entry(
        "Root-mean-square error against the measured laxity",
        only="a laxity table as protocol",
        default=None,
    )

    @property
    @override
    def failure(self) -> str:
        """That no trial has an equilibrium; empty where one has."""
        if self.n_converged:
            return ""
        return f"none of the {self.n_trials} trials has an equilibrium; see result.json"


@verb
def simulate(
    run: Run,
    subject: options.Subject,
    protocol: Annotated[
        TrialsLike,
        option(
            f"The trials: {options.PROTOCOLS}. Measured trials are run as `fit` would run them.",
            in_python="Or a `Protocol`. A subject that was fitted begins at the poses of its fit.",
            metavar="PROTOCOL",
            typed=str,
        ),
    ] = "seed63",
    values: Annotated[
        ValuesLike,
        option(
            "Set a parameter, such as ACL.stiffness_kN=9.5.",
            "--set",
            in_python="A list of texts, or numbers by name.",
            metavar="NAME=VALUE",
            typed=list[str] | None,
        ),
    ] = None,
    *,
    start: Annotated[
        StartLike,
        option(
            "Ligament parameters: subject (its own values), IG1 to IG4 of the paper, or a file "
            "ending in .toml. {--set} changes single ones.",
            in_python=options.VALUES,
            typed=str,
        ),
    ] = "subject",
    noise: Annotated[
        NoiseLike,
        option(
            "Add noise with this standard deviation, such as 0.3mm,0.3deg.",
            in_python="A text, two numbers in mm and deg, or one number for both.",
            metavar="MM,DEG",
            typed=str | None,
        ),
    ] = None,
    noise_correlation: Annotated[
        float, option("Correlation between the five errors of a trial.")
    ] = 0.0,
    noise_student: Annotated[
        float | None, option("Degrees of freedom of Student's t noise; normal noise if not given.")
    ] = None,
    continuation: Annotated[Continuation, options.LOAD_STEPS] = "continuation",
    contact: Annotated[
        Contact,
        option(
            "field: a smooth distance field. mesh: the law of the paper between triangles, which "
            "is slow."
        ),
    ] = "field",
    translations: Annotated[
        Translations,
        option(
            "Definition of the translations in laxity.csv: components along the axes of Grood and "
            "Suntay, projections on them, or along the axes of femur or tibia."
        ),
    ] = COMPONENTS,
    seed: options.Seed = 0,
    **_: Unpack[options.RunOptions],
) -> Simulation:
    """The simulated laxity of a knee; a trial without equilibrium is no error but has an outcome.

    Writes the laxity to laxity.csv, and how each trial ended to result.json. A trial without a
    stable pose has blank cells.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    """
    if noise is None and (noise_correlation or noise_student is not None):
        raise ValueError(
            "--noise-correlation and --noise-student describe the noise; "
            "give its size with --noise, for example --noise 0.3mm,0.3deg"
        )
    sizes = None if noise is None else noise_of(noise)
    tests = read_tests(protocol)
    chosen = values_of(values)
    trials = tests.protocol if isinstance(tests, Laxity) else tests
    model = LaxityModel(knee=subject, protocol=trials, continuation=continuation, contact=contact)
    if isinstance(tests, Laxity):
        its_own = replace(model, order=tests.order, phase=tests.phase)
        model = its_own if subject.poses else model.with_tests(tests)
    begun = load_start(start, model.parameters).tolist()
    theta = model.parameters.vector(dict(zip(model.parameters.names, begun, strict=True)) | chosen)
    warm_up(subject, trials)
    run.start_clock()
    said = path_findings(model)
    if subject.poses:
        model = continued_from_own_poses(model, theta)
    prediction = model.predict(theta, derivatives=False)
    noisy = None
    if sizes is not None:
        noisy = add_noise(
            Laxity(protocol=trials, coordinates=prediction.coordinates),
            sd_mm=sizes[0],
            sd_deg=sizes[1],
            seed=seed,
            correlation=noise_correlation,
            student_degrees=noise_student,
        )
    answer = Simulation(
        **simulated(model, prediction),
        noisy=noisy,
        rmse=laxity_rmse(Laxity(protocol=trials, coordinates=prediction.coordinates), tests)
        if isinstance(tests, Laxity) and tests.is_measured.any()
        else None,
        assumptions=said,
        findings=rim_findings(trials.trials, prediction),
    )
    if run.out is not None:
        write_laxity(noisy or answer.laxity, run.out / LAXITY_FILE, translations=translations)
    return answer


def simulated(model: LaxityModel, prediction: Prediction) -> dict[str, Any]:
    """The fields of a `SimulatedLaxity` by name."""
    ends = zip(
        model.protocol.trials,
        prediction.outcomes,
        prediction.reasons,
        prediction.margins.tolist(),
        prediction.rim_share.tolist(),
        strict=True,
    )
    return {
        "subject": model.knee.name,
        "protocol": model.protocol,
        "trials": tuple(
            TrialEnd(
                trial=trial, outcome=outcome, reason=reason, margin_N_per_mm=margin, rim_share=share
            )
            for trial, outcome, reason, margin, share in ends
        ),
        "coordinates": prediction.coordinates,
        "tension_N": tensions_of(model, prediction),
        "ligaments": tuple(x.name for x in model.knee.ligaments),
        "parameter_names": model.parameters.names,
        "theta": prediction.theta,
    }
