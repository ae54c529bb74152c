"""`identknee subject settle`: insertions moved until the trials converge."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import identknee as ik
from identknee.cli.command import Json, Out, Seed, Subject, Workers, show, timed
from identknee.cli.lazily import knee_digest, warm_up
from identknee.runs.errors import NotComputed
from identknee.runs.executors import threads
from identknee.runs.files import prepare_folder
from identknee.runs.record import record

if TYPE_CHECKING:
    from identknee.model.insertion_moves import SettledKnee

ProtocolName = Annotated[
    str, typer.Option(help="seed63, table2, drawer, or the path of a TOML file.")
]
Within = Annotated[
    float,
    typer.Option(
        metavar="MM",
        help="Uncertainty of the insertions, up to 8 mm. They are moved within it if trials "
        "have no stable pose.",
    ),
]


def settle(
    context: typer.Context,
    subject: Subject,
    protocol: ProtocolName = "seed63",
    within: Within = 3.0,
    out: Out = Path("identknee-settled"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Move the insertions of SUBJECT within their uncertainty until all trials are stable.

    Writes a subject folder with the moved insertions, and says how far each one moved. A moved
    insertion is no longer the one that was segmented. The exit code is 1 if some trials still
    have no stable pose. Nothing is random: the seed changes nothing.
    """
    prepare_folder(out)
    from identknee.model.insertion_moves import settle as find
    from identknee.report.groups import subject_groups
    from identknee.report.result_files import write_result

    trials, knee = ik.load_protocol(protocol), ik.read_subject(subject)
    recording = record("subject settle", context.params, {"subject": knee_digest(knee)}, seed)
    model = ik.LaxityModel(knee=knee, protocol=trials)
    warm_up(knee, trials)
    with threads(workers) as executor:
        found, seconds = timed(lambda: find(model, within_mm=within, executor=executor))
    settled = replace(found.knee, name=f"{knee.name}_settled")
    ik.write_subject(settled, out)
    summary = write_result(
        out, _summary(found, seconds, knee.name), subject_groups(settled), recording.finish()
    )
    show(summary, _lines(found, out), as_json=as_json)
    if found.n_after < found.n_trials:
        raise NotComputed(
            f"{found.n_trials - found.n_after} of {found.n_trials} trials still do not converge; "
            "allow more with --within, up to 8 mm, or correct the ligament parameters"
        )


def _summary(found: "SettledKnee", seconds: float, name: str) -> dict[str, Any]:
    shifts = {
        (ligament.name, bone): found.shifts[i, k]
        for i, ligament in enumerate(found.knee.ligaments)
        for k, bone in enumerate(("femur", "tibia"))
    }
    return {
        "subject": name,
        "n_trials": found.n_trials,
        "n_converged_before": found.n_before,
        "n_converged_after": found.n_after,
        "lowest_margin_N_per_mm": found.lowest_margin,
        "moved": [
            {
                "ligament": ligament,
                "bone": bone,
                "distance_mm": distance,
                "shift_mm": shifts[ligament, bone],
            }
            for (ligament, bone), distance in found.distances.items()
        ],
        "seconds": seconds,
    }


def _lines(found: "SettledKnee", out: Path) -> list[str]:
    first = (
        f"{found.n_after} of {found.n_trials} trials converge, {found.n_before} before; the lowest "
        f"stability margin is {found.lowest_margin:.3g} N/mm."
    )
    moved = [f"  {x}" for x in found.words] or ["No insertion was moved."]
    return [first, *moved, f"Written to {out}. Next: identknee subject check {out}"]
