"""Writes the results that are mutated: what every verb leaves on a tiny protocol, as `results/`.

By hand, after a verb's results have changed: `python tests/fuzz/make_results.py`. It takes minutes.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "support"))

from diagnoses import FRAME, short_data
from held import both_of, fixing
from typer.testing import CliRunner

from identknee.cli.app import app
from identknee.laxity.table import write_laxity
from identknee.subject.reference import reference_knee

RESULTS = Path(__file__).parent / "results"
PROTOCOL = """
format = 1
name = "tiny"
[[ramps]]
flexion_deg = [20]
load = "internal_moment_Nm"
values = [-4, 0, 4]
[[ramps]]
flexion_deg = [20]
load = "anterior_force_N"
values = [-60, 60]
[[ramps]]
flexion_deg = [20]
load = "varus_moment_Nm"
values = [-5, 5]
"""
FEW = fixing(both_of("PCL", "LCL", "MCL"))
NAME = "ACL.stiffness_kN"
VERBS = {
    "simulate": ["simulate", "reference", "--protocol", "PROTOCOL", "--noise", "0.3mm,0.3deg"],
    "check": ["subject", "check", "reference", "--protocol", "PROTOCOL", "--samples", "2"],
    "fit": ["fit", "reference", "DATA"],
    "sweep": ["sweep", "reference", "DATA", "--n-starts", "4", "--paths", "2"],
    "profile": ["profile", "reference", "DATA", *FEW, "--parameter", NAME],
    "sample": ["sample", "reference", "DATA", *FEW, "--ensembles", "2", "--budget", "1000"],
    "information": ["information", "reference", "DATA", *FEW],
    "equivalents": ["equivalents", "reference", "DATA", *FEW, "--n-sets", "2"],
    "sobol": ["sensitivity", "reference", "--protocol", "PROTOCOL", "--samples", "2"],
    "morris": [
        *("sensitivity", "reference", "--protocol", "PROTOCOL", "--method", "morris"),
        *("--samples", "4"),
    ],
    "diagnose": ["diagnose", "reference", "FRAMED"],
    "isolability": [
        *("diagnose", "reference", "--protocol", "PROTOCOL", "--noise", "0.3mm,0.3deg"),
    ],
    "design": [
        *("design", "reference", "DATA", *FEW, "--n-trials", "1", "--target", NAME),
        *("--candidates", "drawer", "--uncertain", "insertions=0.3mm"),
    ],
    "demo": ["demo", "--runs", "1", "--budget", "60"],
}


def main() -> None:
    """Write the results of the verbs named, or of all."""
    chosen = sys.argv[1:] or list(VERBS)
    with tempfile.TemporaryDirectory() as folder:
        protocol, data = Path(folder) / "tiny.toml", Path(folder) / "simulate" / "laxity.csv"
        protocol.write_text(PROTOCOL, encoding="utf-8")
        # With a cause to name.
        framed = write_laxity(short_data(reference_knee(), FRAME), Path(folder) / "framed.csv")
        for verb in dict.fromkeys(["simulate", *chosen]):
            out = Path(folder) / verb
            names = {"PROTOCOL": str(protocol), "DATA": str(data), "FRAMED": str(framed)}
            words = [names.get(x, x) for x in VERBS[verb]]
            result = CliRunner().invoke(app, [*words, "--out", str(out)])
            print(verb, result.exit_code, result.output.splitlines()[-1:])
            if verb in chosen:
                _keep(out, RESULTS / verb, folder)


def _keep(out: Path, target: Path, folder: str) -> None:
    """What `report` reads, and without the paths of this machine."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    summary = json.loads((out / "result.json").read_text(encoding="utf-8"))
    text = json.dumps(summary, indent=1, ensure_ascii=False).replace(folder, "data")
    (target / "result.json").write_text(text + "\n", encoding="utf-8")
    if (out / "result.nc").exists():
        shutil.copy(out / "result.nc", target / "result.nc")


if __name__ == "__main__":
    main()
