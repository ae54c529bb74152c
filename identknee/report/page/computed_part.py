"""How results were computed, and what further verbs would answer."""

import json
import shlex
from collections.abc import Sequence
from html import escape

from identknee.report.page.markup import bullets, disclosed, element, table_html
from identknee.report.page.results import Findings, Result
from identknee.report.tables import Column, Table
from identknee.verbs.registry import verbs


def computed_html(results: Sequence[Result]) -> str:
    """A table of all results, and their records."""
    rows = tuple(
        (
            x.verb,
            x.folder.name,
            short_path(x.data) or "-",
            str(x.record["started"])[:16].replace("T", " "),
            float(x.record["seconds"]),
            "-" if x.record["seed"] is None else str(x.record["seed"]),
        )
        for x in results
    )
    columns = (
        Column(name="verb"),
        Column(name="folder"),
        Column(name="data"),
        Column(name="begun (UTC)"),
        Column(name="time", unit="s", decimals=1),
        Column(name="seed"),
    )
    table = table_html(Table(title="Results on this page", columns=columns, rows=rows))
    records = {f"{x.verb}, {x.folder}": x.record for x in results}
    text = json.dumps(records, indent=2, ensure_ascii=False)
    written = element("pre", escape(text), tabindex="0", aria_label="Records of all results")
    folded = disclosed("Settings, digests of inputs and versions", written)
    return disclosed(f"{len(results)} result{'' if len(results) == 1 else 's'}", table) + folded


def further_html(findings: Findings) -> str:
    """A command for each question that no result answers; empty where all are answered."""
    done = {x.verb for x in findings.results}
    if "demo" in done:
        done.add("profile")
    data = next((x.data for x in reversed(findings.results) if x.data), None)
    if data is None:
        made = findings.of("demo", "simulate")
        data = str(made[0].folder / "laxity.csv") if made else "DATA.csv"
    noise = "" if "demo" not in done else " --noise 0.5mm,0.5deg"
    return bullets(
        f"{escape(verb.suggestion)} "
        + element(
            "code",
            escape(f"identknee {verb.name} {shlex.quote(findings.subject)} {shlex.quote(data)}")
            + (noise if verb.name not in ("fit", "sensitivity") else ""),
        )
        for verb in verbs()
        if verb.suggestion and verb.name not in done
    )


def short_path(path: str) -> str:
    """The last two parts of a path.

    Examples
    --------
    >>> short_path("/home/knee/laxity.csv")
    'knee/laxity.csv'
    """
    return "/".join(path.replace("\\", "/").rstrip("/").split("/")[-2:])
