"""`identknee sensitivity`: which parameters the laxity of a knee depends on."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

import identknee as ik
from identknee.cli.command import Json, MaybeData, Out, Seed, Subject, Workers, show, timed
from identknee.cli.identification import WORK, Fixed, Start
from identknee.cli.lazily import knee_digest, warm_up
from identknee.runs.errors import NotComputed
from identknee.runs.files import digest, prepare_folder
from identknee.runs.record import record
from identknee.runs.resume import finish_work

MethodName = Literal["morris", "sobol", "delta", "pawn", "hdmr", "shapley"]
ProtocolName = Annotated[
    str | None,
    typer.Option(
        help="The trials without DATA.csv: seed63 (also without this), table2, drawer or a TOML "
        "file."
    ),
]
Method = Annotated[
    MethodName,
    typer.Option(
        help="morris and sobol vary parameters independently in the box k +-50 %, eps_r +-3 %; the "
        "others take the draws of --posterior, or draws from the box."
    ),
]
Samples = Annotated[
    int | None,
    typer.Option(
        help="Trajectories (256 without), blocks (1,024) or draws (2,048, at most so many of the "
        "posterior). More in the same --out continue what is there."
    ),
]
Posterior = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder of an identknee sample.")
]
OF_MAIN_INTEREST = {
    "morris": "mu_star",
    "sobol": "ST",
    "delta": "delta",
    "pawn": "pawn",
    "hdmr": "ST",
    "shapley": "shapley",
}
MEANINGS = {
    "morris": "its mean effect (mm or deg) when it alone crosses its whole range",
    "sobol": "the share of the variance that would be left if all others were known",
    "delta": "how much knowing it changes the distribution of the output, 0 to 1",
    "pawn": "how far knowing it shifts the distribution of the output, 0 to 1",
    "hdmr": "the share of the variance that its terms explain",
    "shapley": "its fair share of the variance, with what it shares with others",
}


def sensitivity(
    context: typer.Context,
    subject: Subject,
    data: MaybeData = None,
    protocol: ProtocolName = None,
    method: Method = "sobol",
    samples: Samples = None,
    posterior: Posterior = None,
    start: Start = "subject",
    fixed: Fixed = None,
    out: Out = Path("identknee-sensitivity"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say which parameters the laxity of a knee depends on.

    Outputs are grouped by coordinate, flexion angle and kind of load; failures to converge are an
    output of their own. The middle of the box is --start. All indices with confidence intervals and
    their convergence go to result.nc. A stopped run resumes.
    """
    if data is not None and protocol is not None:
        raise ValueError(
            "the trials are those of DATA.csv or those of --protocol: leave out one of both"
        )
    prepare_folder(out)
    # These load xarray, which takes longer than reading a subject.
    from identknee.report.result_files import write_result
    from identknee.report.sensitivity_groups import sensitivity_groups
    from identknee.runs.executors import process_pool
    from identknee.runs.resume import open_work

    outputs, inputs = _outputs(subject, data, protocol or "seed63", start, fixed)
    over, inputs = _where(outputs, posterior, samples, inputs)
    recording = record("sensitivity", context.params, inputs, seed)
    warm_up(outputs.model.knee, outputs.model.protocol)
    about = {
        "verb": "sensitivity",
        "inputs": inputs,
        "parameters": outputs.parameters.names,
        "middle": outputs.free.fixed_values,
        "seed": seed,
    }
    with open_work(out / WORK, about) as store, process_pool(workers) as executor:
        found, seconds = timed(
            lambda: ik.sensitivity(
                outputs,
                over,
                method=method,
                n_samples=samples,
                seed=seed,
                executor=executor,
                store=store,
            )
        )
    summary = write_result(
        out, _summary(found, seconds), sensitivity_groups(found), recording.finish()
    )
    finish_work(out / WORK)
    show(summary, _lines(found, out), as_json=as_json)
    if found.failed_share[-1] == 1.0:
        raise NotComputed(
            f"no parameter set converges in all trials; see: identknee subject check {subject}"
        )


def _outputs(
    subject: str, data: str | None, protocol: str, start: str, fixed: list[str] | None
) -> "tuple[Any, dict[str, str]]":
    from identknee.model.laxity_outputs import LaxityOutputs
    from identknee.report.sensitivity_groups import laxity_groups

    laxity = None if data is None else ik.read_laxity(data)
    trials = ik.load_protocol(protocol) if laxity is None else laxity.protocol
    knee = ik.read_subject(subject)
    model = ik.LaxityModel(knee=knee, protocol=trials)
    free = model.parameters.with_fixed(fixed or (), ik.load_start(start, model.parameters))
    if free.parameters.n < 2:
        raise ValueError(
            "a sensitivity analysis needs at least two parameters that vary; fix fewer"
        )
    outputs = LaxityOutputs(
        model=model,
        groups=laxity_groups(trials),
        free=free,
        zero="absolute" if laxity is None else laxity.zero,
    )
    protocol_digest = digest(trials.loads.tobytes() + trials.flexion_deg.tobytes())
    return outputs, {"subject": knee_digest(knee), "protocol": protocol_digest}


def _where(
    outputs: Any, posterior: Path | None, samples: int | None, inputs: dict[str, str]
) -> "tuple[Any, dict[str, str]]":
    """The box, or the draws of a posterior, and the digests with those of the draws."""
    from identknee.identify.sensitivity.designs import box_around
    from identknee.identify.sensitivity.sensitivity import DEFAULT_DRAWS
    from identknee.report.sensitivity_groups import posterior_draws

    if posterior is None:
        middle = outputs.free.restrict(outputs.free.fixed_values)
        return box_around(outputs.parameters, middle), inputs
    draws = posterior_draws(posterior, outputs.parameters.names, samples or DEFAULT_DRAWS)
    return draws, {**inputs, "posterior": digest(np.ascontiguousarray(draws).tobytes())}


def _summary(found: "ik.Sensitivity", seconds: float) -> dict[str, Any]:
    missing = found.more_simulations()
    return {
        "method": found.method,
        "n_samples": found.n_samples,
        "n_simulations": found.n_simulations,
        "seconds": seconds,
        "failed_share": found.failed_share[-1],
        "failures": found.rule,
        "largest_half_width": found.largest_half_width[:-1].max(),
        "more_simulations_to_half_width_0.02": missing[:-1].max(),
        "indices": {
            name: {
                parameter: {
                    "largest": {"value": values[top], "group": found.groups[top]},
                    "of_failure": index.final[-1, i],
                }
                for i, parameter in enumerate(found.parameters.names)
                for values in [index.final[:-1, i]]
                for top in [_largest(values)]
            }
            for name, index in found.indices.items()
        },
    }


def _largest(values: Any) -> int:
    """Where the largest known value stands; the first where none is known."""
    return int(np.argmax(np.where(np.isnan(values), -np.inf, values)))


def _lines(found: "ik.Sensitivity", out: Path) -> list[str]:
    name = OF_MAIN_INTEREST[found.method]
    index = found.indices[name]
    width = max(len(x) for x in found.parameters.names)
    lines = [
        f"Largest index of each parameter, {MEANINGS[found.method]}:",
        f"{'':{width}}  {'largest ' + name:>18}  {'of failure':>10}  for",
    ]
    for i, parameter in enumerate(found.parameters.names):
        top = _largest(index.final[:-1, i])
        value = f"{index.final[top, i]:.3f} +- {index.final_half_widths[top, i]:.3f}"
        lines.append(
            f"{parameter:{width}}  {value:>18}  {index.final[-1, i]:10.3f}  {found.groups[top]}"
        )
    lines.append(
        f"{100 * found.failed_share[-1]:.2g} % of {found.n_simulations} simulations had a trial "
        f"without prediction; {found.rule}."
    )
    missing = found.more_simulations()[:-1].max()
    if missing > 0:
        more = f"{missing:.0f} more simulations" if math.isfinite(missing) else "other trials"
        lines.append(f"For half-widths of 0.02 in every group: {more} (about).")
    lines.append(f"Results: {out}")
    return lines
