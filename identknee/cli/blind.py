"""`identknee blind`: laxity of a knee with a hidden effect."""

from pathlib import Path
from typing import Annotated, Any

import typer

import identknee as ik
from identknee.cli.command import Json, Out, Seed, SubjectOrReference, Workers, show, timed
from identknee.cli.lazily import knee_digest
from identknee.runs.files import prepare_folder, write_json
from identknee.runs.record import record

Effect = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ID", help="The hidden cause: its name, random, or none. Two names may be given."
    ),
]
# Of the signal asked for: less than this is another case.
REACHED = 0.9
Signal = Annotated[
    float | None,
    typer.Option(
        help="Size of the effect relative to the noise; taken from the literature if not given."
    ),
]

Uncertain = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=SIZE,...",
        help="How wrong the knee and the tests are to be, as in insertions=2mm,registration=2deg: "
        "one standard deviation. Exact if not given. Give `diagnose` the same.",
    ),
]


def blind(
    context: typer.Context,
    subject: SubjectOrReference = "reference",
    effect: Effect = None,
    signal: Signal = None,
    uncertain: Uncertain = None,
    out: Out = Path("identknee-blind"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Make laxity data of SUBJECT with a hidden effect, to test a diagnosis.

    The data come from an independent generator. Writes laxity.csv for `diagnose`, and a sealed
    truth.json for `reveal`. The signal is the root of the chi-square that ligament parameters
    alone cannot fit. It runs on one thread: more workers change nothing.
    """
    prepare_folder(out)
    knee = ik.read_subject(subject)
    recording = record("blind", _told(context.params), {"subject": knee_digest(knee)}, seed)
    conditions = ik.blind.stated_conditions(uncertain)
    case, seconds = timed(
        lambda: ik.blind.blind_case(
            knee, seed=seed, effect=_chosen(effect), signal=signal, conditions=conditions
        )
    )
    ik.blind.write_blind(case, out)
    if signal is not None:
        _say_signal(case.truth, signal, is_secret=effect is None or "random" in effect)
    summary = {
        "subject": knee.name,
        "n_trials": case.laxity.n,
        "seconds": seconds,
        "record": recording.finish().to_dict(),
    }
    write_json(out / "result.json", summary)
    show(summary, [f"{case.laxity.n} trials: {out / 'laxity.csv'}"], as_json=as_json)


def _say_signal(truth: "ik.blind.Truth", wanted: float, *, is_secret: bool) -> None:
    """Where the signal asked for was not reached, say so; what is hidden stays hidden."""
    if is_secret:
        # Said whatever was drawn, so that it tells nothing about it.
        typer.echo(
            f"The signal may be less than {wanted:g}: nothing may be hidden, or an effect at its "
            "largest plausible size. identknee reveal says what it is.",
            err=True,
        )
    elif truth.effects and truth.signal < REACHED * wanted:
        names = " and ".join(truth.effects)
        why = "the largest plausible size gives no more" if truth.is_largest else "it stays below"
        typer.echo(
            f"The signal of {names} is {truth.signal:.2g}, not {wanted:g}: {why}. Ask for less, or "
            "choose another --effect or --seed.",
            err=True,
        )


def _chosen(effect: list[str] | None) -> str | list[str] | None:
    names = effect or ["random"]
    if len(names) > 1:
        return names
    return None if names[0] == "none" else names[0]


def _told(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings without what would give the hidden effect away."""
    return {name: value for name, value in settings.items() if name not in ("effect", "signal")}
