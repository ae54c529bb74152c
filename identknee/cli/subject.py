"""`identknee subject`: list, check, show, export and import subjects' knees."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import identknee as ik
from identknee.cli.command import WRONG_INPUT, Json, Out, Seed, Subject, Verb, Verbs, Workers, show
from identknee.cli.lazily import knee_digest, warm_up
from identknee.cli.subject_list import list_subjects
from identknee.cli.subject_settle import ProtocolName, Within, settle
from identknee.runs.executors import threads
from identknee.runs.files import digest, prepare_folder, write_atomically
from identknee.runs.record import Recording, record
from identknee.subject.examples import opensim_file

SCENE_FILE = "scene.png"

app = typer.Typer(
    cls=Verbs,
    help="List the knees that come with identknee; check, show, export or import one.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Samples = Annotated[
    int, typer.Option(min=0, help="Number of parameter sets to draw from the ranges; 0 for none.")
]
OsimFile = Annotated[
    str,
    typer.Argument(
        metavar="FILE.osim",
        help="An OpenSim/JAM model, or lenhart2015 for the one that comes with identknee.",
    ),
]
PROPOSAL = (
    "The subject does not state how well it is known, so it counts as exact. If you know nothing "
    "better, add to subject.toml: [uncertainty] insertions_mm = 2.0 (segmentation repeats to 1 to "
    "4 mm)."
)
Fitted = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="A result of fit, profile or simulate for SUBJECT, whose parameters the knee gets, or "
        "a folder with several results.",
    ),
]
Osim = Annotated[bool, typer.Option("--osim", help="Also write an OpenSim 4 model.")]
Source = Annotated[
    str | None,
    typer.Option(
        metavar="FILE.osim",
        help="The OpenSim model that SUBJECT was imported from: write a copy of it with the "
        "knee's ligaments. Give lenhart2015 for the one that comes with identknee.",
    ),
]
Vtk = Annotated[
    bool,
    typer.Option("--vtk", help="Also write the knee in every trial, for ParaView and PyVista."),
]
PosedTrials = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="The trials of --vtk: seed63, table2, drawer, or a TOML file. If not given, "
        "those of the result, or drawer.",
    ),
]
Bundles = Annotated[
    Literal["separate", "merged"],
    typer.Option(help="Keep the bundles separate, or merge them to four single lines."),
]

app.command("list", epilog="Example: identknee subject list --json")(list_subjects)
app.command(
    cls=Verb, epilog="Example: identknee subject settle lenhart2015 --within 5 --out my-knee"
)(settle)


@app.command(cls=Verb, epilog="Example: identknee subject check my-knee")
def check(
    context: typer.Context,
    subject: Subject,
    protocol: ProtocolName = "seed63",
    samples: Samples = 200,
    within: Within = 3.0,
    out: Out = Path("identknee-check"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Check SUBJECT, and whether its trials are stable.

    Checks surfaces, frames and ligaments, then the stability of the model under a protocol. It
    does so at the parameters of the subject and in a range around them: stiffness by +-50 %,
    reference strain by +-3 %. If trials have no stable pose, it says which insertions to move,
    within their uncertainty. The exit code is 2 if there is an error.
    """
    prepare_folder(out)
    trials, knee = ik.load_protocol(protocol), ik.read_subject(subject)
    recording = record("subject check", context.params, {"subject": knee_digest(knee)}, seed)
    findings = ik.check_geometry(knee)
    stability = None
    if not _has_error(findings):
        warm_up(knee, trials)
        model = ik.LaxityModel(knee=knee, protocol=trials)
        with threads(workers) as executor:
            stability = ik.model.check_stability(
                model, n_samples=samples, within_mm=within, seed=seed, executor=executor
            )
        findings += stability.findings
    from identknee.report.groups import stability_groups, subject_groups

    groups = dict(subject_groups(knee))
    if stability is not None:
        groups.update(stability_groups(stability))
    summary = _write(out, _check_summary(knee, findings, stability), groups, recording)
    show(summary, _check_lines(knee, findings, stability), as_json=as_json)
    if _has_error(findings):
        raise typer.Exit(WRONG_INPUT)


@app.command("show", cls=Verb, epilog="Example: identknee subject show reference --out picture")
def draw(
    context: typer.Context,
    subject: Subject,
    out: Out = Path("identknee-show"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Draw SUBJECT in its scanned pose."""
    prepare_folder(out)
    knee = ik.read_subject(subject)
    recording = record("subject show", context.params, {"subject": knee_digest(knee)}, seed)
    from identknee.report.groups import subject_groups
    from identknee.report.picture import png

    path = write_atomically(out / SCENE_FILE, png(ik.scene(knee)))
    summary = _write(out, _knee_summary(knee), subject_groups(knee), recording)
    show(summary, [f"{knee.name}: {path}"], as_json=as_json)


@app.command(cls=Verb, epilog="Example: identknee subject export reference --out my-knee")
def export(
    context: typer.Context,
    subject: Subject,
    fitted: Fitted = None,
    osim: Osim = False,
    source: Source = None,
    vtk: Vtk = False,
    protocol: PosedTrials = None,
    out: Out = Path("identknee-subject"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Write SUBJECT as a subject folder, and for other tools.

    With --fitted the knee has the parameters of a result, and parameters.tsv lists them in the
    form of PEtab with their 95 % sets. With --source they are written into a copy of the OpenSim
    model that the knee was imported from; all else in that model stays. With --osim alone the
    model holds two bones, their cartilage and the ligaments. With --vtk the knee is written in
    every trial, with gap and pressure on each face and the force of each ligament.
    """
    prepare_folder(out)
    knee = ik.read_subject(subject)
    recording = record("subject export", context.params, {"subject": knee_digest(knee)}, seed)
    from identknee.report.export import export_knee

    written = export_knee(
        knee, out, fitted=fitted, osim=osim, source=source, vtk=vtk, protocol=protocol
    )
    others = [f"Also written: {x}" for x in written.others]
    _tell_written(written.knee, out, others, recording, as_json=as_json)


@app.command(
    "import-osim",
    cls=Verb,
    epilog="Example: identknee subject import-osim model.osim --out knee",
)
def import_osim(
    context: typer.Context,
    file: OsimFile,
    bundles: Bundles = "separate",
    out: Out = Path("identknee-subject"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Turn an OpenSim model into a subject folder."""
    prepare_folder(out)
    knee = ik.import_opensim(file, bundles=bundles)
    recording = record(
        "subject import-osim", context.params, {"osim": digest(opensim_file(file))}, seed
    )
    ik.write_subject(knee, out)
    _tell_written(knee, out, [], recording, as_json=as_json)


def _tell_written(
    knee: "ik.Knee", out: Path, others: Sequence[str], recording: Recording, *, as_json: bool
) -> None:
    from identknee.report.groups import subject_groups

    summary = _write(out, _knee_summary(knee), subject_groups(knee), recording)
    names = ", ".join(x.name for x in knee.ligaments)
    line = f"{knee.name}: {len(knee.ligaments)} ligaments ({names}) written to {out}"
    show(summary, [line, *others, f"Next: identknee subject check {out}"], as_json=as_json)


def _write(out: Path, summary: dict[str, Any], groups: Any, recording: Recording) -> dict[str, Any]:
    from identknee.report.result_files import write_result

    return write_result(out, summary, groups, recording.finish())


def _knee_summary(knee: "ik.Knee") -> dict[str, Any]:
    return {
        "subject": knee.name,
        "side": knee.side,
        "n_vertices": {
            "femur": len(knee.femur.vertices),
            "tibia": [len(x.vertices) for x in knee.tibia],
        },
        "ligaments": [
            {
                "name": x.name,
                "reference_length_mm": x.length,
                "stiffness_kN": x.stiffness_kN,
                "reference_strain_pct": x.reference_strain_pct,
            }
            for x in knee.ligaments
        ],
    }


def _check_summary(
    knee: "ik.Knee",
    findings: "Sequence[ik.subject.GeometryFinding]",
    stability: "ik.model.StabilityReport | None",
) -> dict[str, Any]:
    counts = Counter(x.severity for x in findings)
    summary: dict[str, Any] = {
        **_knee_summary(knee),
        "n_errors": counts["error"],
        "n_warnings": counts["warning"],
        "findings": [
            {
                "severity": x.severity,
                "subject": x.subject,
                "sentence": x.sentence,
                "remedy": x.remedy,
            }
            for x in findings
        ],
        "stability": None,
    }
    if stability is not None:
        summary["stability"] = {
            "n_trials": len(stability.trials),
            "n_converged": stability.n_converged,
            "lowest_margin_N_per_mm": stability.lowest_margin,
            "n_samples": stability.n_samples,
            "box_converged_share": stability.converged_share,
            "box_outcomes": {end.value: n for end, n in stability.box_outcomes.items()},
            "contact_points_change": {"mm": stability.change_mm, "deg": stability.change_deg},
            "moves": [asdict(x) for x in stability.moves],
        }
    return summary


def _check_lines(
    knee: "ik.Knee",
    findings: "Sequence[ik.subject.GeometryFinding]",
    stability: "ik.model.StabilityReport | None",
) -> list[str]:
    lines = [f"{knee.name} ({knee.side} knee, {len(knee.ligaments)} ligaments)"]
    for finding in findings:
        sentence = f"{finding.severity:8}{finding.subject}: {finding.sentence}"
        lines.append(f"{sentence} {finding.remedy}".rstrip())
    if knee.uncertainty.is_exact:
        lines.append(PROPOSAL)
    if stability is None:
        lines.append("Stability was not checked: mend the errors above first.")
    return lines


def _has_error(findings: "Sequence[ik.subject.GeometryFinding]") -> bool:
    return any(x.severity == "error" for x in findings)
