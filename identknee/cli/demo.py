"""`identknee demo`: the paper's question on the reference knee, and the answer, in a minute."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Json, Out, Seed, Workers, run_verb
from identknee.cli.report import PAGE

Runs = Annotated[int, typer.Option(min=1, help="Runs of the Complex method from each start.")]
Budget = Annotated[int, typer.Option(min=1, help="Largest number of simulations per run.")]
BEGINNING = (
    "Reference knee, 63 trials, noise-free. Short settings.\n"
    "Fitting from the paper's four starts: Complex ({} runs each), least squares. Then profiles "
    "from noisy data."
)


def demo(
    context: typer.Context,
    runs: Runs = 2,
    budget: Budget = 2500,
    out: Out = Path("identknee-demo"),
    seed: Seed = 0,
    workers: Workers = "2",
    as_json: Json = False,
) -> None:
    """Ask the paper's question, and answer it in about a minute.

    Does a good fit mean that the parameters are right? Laxity of known parameters is simulated
    in 63 trials. It is fitted from the four initial guesses of the paper, by its Complex method
    and by least squares. Then noise is added, and profiles show within what limits the data
    determine each parameter. The settings are short, with a few runs per start. Open
    report.html in a browser to see the answer.
    """
    if not as_json:
        typer.echo(BEGINNING.format(runs), err=True)
    answer = run_verb(context, ik.demo)
    # These load matplotlib, which takes longer than most mistakes.
    from identknee.report.demo_pictures import write_demo_pictures
    from identknee.report.write_report import write_report

    write_demo_pictures(answer, out)
    write_report(out, out / PAGE)
    if not as_json:
        typer.echo(f"Open in a browser: {out / PAGE}")
