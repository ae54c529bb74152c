"""`identknee diagnose --protocol`: what trials could tell, before any data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

import identknee as ik
from identknee.cli.command import show, timed
from identknee.cli.identification import file_digests
from identknee.cli.lazily import knee_digest, warm_up
from identknee.runs.errors import NotComputed
from identknee.runs.files import write_atomically
from identknee.runs.record import record
from identknee.verbs.values import noise_sizes

if TYPE_CHECKING:
    from identknee.diagnosis.advice.protocol import ProtocolIsolability

PICTURE = "isolability.png"


def say_isolability(
    context: typer.Context,
    subject: str,
    protocol: str,
    noise: str,
    *,
    out: Path,
    seed: int,
    as_json: bool,
) -> None:
    """Write and show which causes a protocol could show and tell apart on a subject.

    Raises
    ------
    ValueError
        If an option or a file is wrong.
    NotComputed
        If the subject has no prediction in any trial.
    """
    from identknee.diagnosis.advice.protocol import protocol_isolability
    from identknee.report.diagnosis_figures import isolability_figure
    from identknee.report.isolability_groups import isolability_groups, isolability_summary
    from identknee.report.picture import png
    from identknee.report.result_files import write_result

    mm, deg = noise_sizes(noise)
    knee, trials = ik.read_subject(subject), ik.load_protocol(protocol)
    inputs = {"subject": knee_digest(knee), **file_digests(protocol=protocol)}
    recording = record("diagnose", context.params, inputs, seed)
    warm_up(knee, trials)
    found, seconds = timed(
        lambda: protocol_isolability(knee, trials, sd_mm=mm, sd_deg=deg, seed=seed)
    )
    if found is None:
        raise NotComputed(
            "the subject's own values have no prediction in any trial of the protocol. See: "
            f"identknee subject check {subject}"
        )
    write_atomically(out / PICTURE, png(isolability_figure(found.distances)))
    summary = {**isolability_summary(found), "seconds": seconds}
    summary = write_result(out, summary, isolability_groups(found), recording.finish())
    show(summary, [*shown(_sections(found)), f"Results: {out}"], as_json=as_json)


def shown(sections: Mapping[str, Sequence[str]]) -> list[str]:
    """The lines of sections below their headings."""
    lines: list[str] = []
    for heading, texts in sections.items():
        lines += [typer.style(heading, bold=True), *(f"  {x}" for x in texts), ""]
    return lines


def _sections(found: "ProtocolIsolability") -> dict[str, list[str]]:
    from identknee.report.diagnosis_text import visibility_line

    width = max(len(x.name) for x in found.visibility)
    seen = [f"{x.name:{width}}  {visibility_line(x)}" for x in found.visibility]
    sections = {"What the trials would show in nine of ten data sets": seen}
    together = []
    for group in found.advice:
        together.append(f"{' | '.join(group.names)}: {group.before:.1f} units of noise apart")
        trials = ", ".join(group.trials.trials)
        together.append(f"  {group.after:.1f} after adding {trials}")
    alone = [x for x, near in found.look_alikes.items() if not near]
    sections["What they could not tell apart"] = together or ["Nothing."]
    sections["What they could tell from everything else"] = [", ".join(alone) or "Nothing."]
    return sections
