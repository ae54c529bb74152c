"""`identknee diagnose`: what the model gets wrong, and why."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Json, MaybeData, Out, Seed, Subject, Workers, show, timed
from identknee.cli.identification import Noise, file_digests, measured
from identknee.cli.isolability import say_isolability, shown
from identknee.cli.lazily import knee_digest, warm_up
from identknee.laxity.named_tables import laxity_file
from identknee.runs.files import digest, prepare_folder
from identknee.runs.findings import finding_lines
from identknee.runs.record import record

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
    from identknee.diagnosis.diagnose import why_untestable
    from identknee.report.diagnosis_files import write_diagnosis_files
    from identknee.report.diagnosis_groups import diagnosis_groups
    from identknee.report.diagnosis_summary import diagnosis_summary, untestable_summary
    from identknee.report.diagnosis_text import diagnosis_lines
    from identknee.report.result_files import write_result

    knee, laxity = measured(subject, data, noise)
    inputs = {
        "subject": knee_digest(knee),
        "data": digest(laxity_file(data)),
        **file_digests(start=start),
    }
    recording = record("diagnose", context.params, inputs, seed)
    starts = [] if start == "subject" else [start]
    warm_up(knee, laxity.protocol)
    diagnosis, seconds = timed(lambda: ik.diagnose(knee, laxity, starts=starts, seed=seed))
    if diagnosis is None:
        summary = untestable_summary(why_untestable(knee, laxity))
        summary = write_result(out, summary, {}, recording.finish())
        lines = [summary["verdict"].value, summary["sentence"], *summary["reasons"]]
        show(summary, lines, as_json=as_json)
        return
    # All of it is made before any of it is written, so that no half of it is left.
    summary, groups = diagnosis_summary(diagnosis), diagnosis_groups(diagnosis)
    write_diagnosis_files(diagnosis, out)
    summary = write_result(out, {**summary, "seconds": seconds}, groups, recording.finish())
    findings = finding_lines(diagnosis.findings)
    lines = [*shown(diagnosis_lines(diagnosis)), *findings, f"{seconds:.1f} s. Results: {out}"]
    show(summary, lines, as_json=as_json)
