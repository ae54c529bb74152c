"""`identknee diagnose`: what the model gets wrong, and why."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import identknee as ik
from identknee.cli.command import (
    Json,
    MaybeData,
    Out,
    Seed,
    Subject,
    Workers,
    knee_digest,
    show,
    timed,
    warm_up,
)
from identknee.cli.identification import Noise, file_digests, measured
from identknee.cli.isolability import say_isolability, shown
from identknee.laxity.named_tables import laxity_file
from identknee.runs.files import digest, prepare_folder, write_atomically
from identknee.runs.findings import finding_lines, findings_summary
from identknee.runs.record import Recording, record

if TYPE_CHECKING:
    from identknee.diagnosis.diagnose import Diagnosis
    from identknee.diagnosis.gain import Gain

Planned = Annotated[
    str | None,
    typer.Option(
        "--protocol",
        metavar="PROTOCOL",
        help="Without data: say what the trials of seed63, table2, drawer or a TOML file could "
        "tell, with the noise of --noise.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Where one more fit of the model without causes begins: IG1 to IG4 of the paper or a "
        "file ending in .toml; subject for none."
    ),
]
EXTENDED, FITTED, ADVICE = "extended", "fitted.toml", "advised_trials.csv"


def diagnose(
    context: typer.Context,
    subject: Subject,
    data: MaybeData = None,
    protocol: Planned = None,
    noise: Noise = None,
    start: Start = "subject",
    out: Out = Path("identknee-diagnose"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say what the model of SUBJECT gets wrong in DATA.csv, and which physical cause it has.

    The verdict is one of ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED and NOT_TESTABLE, with what else
    would explain the data and which trials would tell. The folder extended is the subject with the
    causes found, for every other verb. With --protocol in place of DATA.csv it says which causes
    such trials could show and tell apart. One thread does it: more workers change nothing.
    """
    if (data is None) == (protocol is None):
        raise ValueError(
            "diagnose needs either DATA.csv or --protocol; give one of both, for example "
            "identknee diagnose reference --protocol seed63 --noise 0.3mm,0.3deg"
        )
    prepare_folder(out)
    if data is None:
        if noise is None:
            raise ValueError("--protocol needs --noise; add for example --noise 0.3mm,0.3deg")
        say_isolability(context, subject, str(protocol), noise, out=out, seed=seed, as_json=as_json)
        return
    from identknee.diagnosis.diagnose import diagnose as find

    knee, laxity = measured(subject, data, noise)
    inputs = {
        "subject": knee_digest(knee),
        "data": digest(laxity_file(data)),
        **file_digests(start=start),
    }
    recording = record("diagnose", context.params, inputs, seed)
    starts = _starts(knee, laxity, start)
    warm_up(knee, laxity.protocol)
    found, seconds = timed(lambda: find(knee, laxity, starts=starts, seed=seed))
    if found is None:
        _say_untestable(out, knee, laxity, recording, as_json=as_json)
        return
    _say(found, seconds, out, recording, as_json=as_json)


def _say(
    found: "Diagnosis", seconds: float, out: Path, recording: Recording, *, as_json: bool
) -> None:
    from identknee.diagnosis.exclusions import exclusions
    from identknee.diagnosis.own_findings import own_findings
    from identknee.report.diagnosis_figures import diagnosis_figures
    from identknee.report.diagnosis_groups import diagnosis_groups
    from identknee.report.diagnosis_summary import diagnosis_summary
    from identknee.report.diagnosis_text import diagnosis_lines
    from identknee.report.picture import png
    from identknee.report.result_files import write_result

    gain, tested, findings = _gain(found), exclusions(found), own_findings(found)
    # All of it is made before any of it is written, so that no half of it is left.
    pictures = {name: png(figure) for name, figure in diagnosis_figures(found).items()}
    said = {"findings": findings_summary(findings), "seconds": seconds}
    summary = {**diagnosis_summary(found, tested, gain), **said}
    groups = diagnosis_groups(found, tested)
    lines = shown(diagnosis_lines(found, tested, gain))
    for name, picture in pictures.items():
        write_atomically(out / f"{name}.png", picture)
    _write_extension(found, out)
    summary = write_result(out, summary, groups, recording.finish())
    lines = [*lines, *finding_lines(findings), f"{seconds:.1f} s. Results: {out}"]
    show(summary, lines, as_json=as_json)


def _starts(knee: "ik.Knee", laxity: "ik.Laxity", start: str) -> list[Any]:
    """The parameters of the ligaments to begin one more fit at; none where the subject's own."""
    model = ik.LaxityModel(knee=knee, protocol=laxity.protocol, effects=())
    theta = ik.load_start(start, model.parameters)
    return [] if start == "subject" else [theta]


def _say_untestable(
    out: Path, knee: "ik.Knee", laxity: "ik.Laxity", recording: Recording, *, as_json: bool
) -> None:
    from identknee.diagnosis.data_noise import noise_of
    from identknee.report.diagnosis_summary import untestable_summary
    from identknee.report.result_files import write_result

    if noise_of(laxity, laxity.coordinates) is None:
        reason = (
            "The data state no noise and their load curves are too short to show it: state it with "
            "--noise, for example --noise 0.3mm,0.3deg."
        )
    else:
        reason = (
            "No parameters near the subject's have a prediction in every measured trial. See: "
            f"identknee subject check; or leave the cells of such trials of {knee.name} blank."
        )
    summary = write_result(out, untestable_summary(reason), {}, recording.finish())
    show(summary, [summary["verdict"].value, summary["sentence"], reason], as_json=as_json)


def _gain(found: "Diagnosis") -> "Gain | None":
    from identknee.diagnosis.causes import explanation_of
    from identknee.diagnosis.gain import measure_gain

    best = explanation_of(found)
    if not best.causes:
        return None
    return measure_gain(
        found.base.fitted,
        best.fitted,
        found.noise.sd,
        noise_degrees=found.noise.degrees_of_freedom,
    )


def _write_extension(found: "Diagnosis", out: Path) -> None:
    """The extended subject, where its fit lies, and the trials to add."""
    from identknee.diagnosis.causes import explanation_of
    from identknee.diagnosis.extended import extended_knee, fitted_values
    from identknee.subject.folder import write_subject

    best = explanation_of(found)
    folder = write_subject(extended_knee(best), out / EXTENDED)
    lines = ["# Where the fit of the extended model lies: --start of other verbs."]
    for owner, values in fitted_values(best).items():
        lines += ["", f"[{owner}]", *(f"{name} = {value!r}" for name, value in values.items())]
    write_atomically(folder / FITTED, "\n".join(lines) + "\n")
    if found.advice is not None:
        ik.write_laxity(_blank(found.laxity, found.advice.trials), out / ADVICE)


def _blank(laxity: "ik.Laxity", trials: "ik.Protocol") -> "ik.Laxity":
    """Trials to measure, their coordinates to be filled in."""
    return ik.Laxity(
        protocol=trials,
        coordinates=np.full((trials.n, laxity.coordinates.shape[1]), np.nan),
        zero=laxity.zero,
        comments=("Trials advised by identknee diagnose: measure, fill in, append to the data.",),
    )
