"""Every reader and every verb, with whole files and calls to change and what is done with them."""

import io
import json
import shutil
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, redirect_stderr
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_judge import commanded
from fuzz_mutations import (
    PLAIN,
    Strategy,
    binaries,
    elements,
    numbers,
    tables,
    texts,
    tomls,
    trees,
)
from hypothesis import strategies as st
from osim_files import write_model
from small_knee import small_knee, small_protocol

from identknee.blind.truth import Truth, read_truth, write_truth
from identknee.calibrate.fit import load_start
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise, read_laxity, write_laxity
from identknee.model.effects.library import effects_of
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import ligament_parameters
from identknee.report.export import polydata
from identknee.report.page.page import report_html
from identknee.report.results import found_results
from identknee.runs.declare import IntArray
from identknee.runs.files import digest
from identknee.runs.store import finish_work, open_work, resumable_map
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import EffectChoice
from identknee.subject.opensim import import_opensim
from identknee.subject.reference import reference_knee
from identknee.subject.surface import Surface, read_surface, write_surface

HERE = Path(__file__).parent
RESULTS = HERE / "results"
# Those of which a page without figures is made: nearly all that can go wrong, in milliseconds.
VERBS = tuple(sorted(x.name for x in RESULTS.iterdir() if x.name != "check"))


@dataclass(frozen=True, kw_only=True)
class Target:
    """One reader or verb.

    Attributes
    ----------
    name
        Of the kind of file or call.
    share
        Of all inputs, in parts of a thousand.
    inputs
        Changed contents.
    run
        What is done with one, in an empty folder of its own; the sentence where a verb refused.
    """

    name: str
    share: int
    inputs: Callable[[], Strategy]
    run: Callable[[bytes, Path], str]


def reads(read: Callable[[Path], object], name: str) -> Callable[[bytes, Path], str]:
    """Writes the content to a file of this name and reads it."""

    def run(content: bytes, folder: Path) -> str:
        (folder / name).write_bytes(content)
        read(folder / name)
        return ""

    return run


@cache
def base() -> Path:
    """A folder with whole files of every kind, made once a process."""
    import tempfile

    folder = Path(tempfile.mkdtemp(prefix="identknee-fuzz-"))
    knee = reference_knee(6.0, femur_edge_mm=5.0)
    effect = EffectChoice(name="compression", values={"force_N": 20.0}, fixed=("force_N",))
    write_subject(replace(knee, effects=(effect,)), folder / "subject")
    write_subject(small_knee(), folder / "small")
    for kind in ("stl", "ply", "obj"):
        write_surface(knee.tibia[0], folder / f"surface.{kind}")
    (folder / "surface.vtp").write_bytes(_vtp(knee.tibia[0]))
    laxity = _laxity()
    write_laxity(laxity, folder / "data.csv")
    write_model(folder, knee)
    write_truth(_truth(), folder)
    with open_work(folder / "store.sqlite", ABOUT) as store:
        resumable_map(_square, range(8), store=store, name="squares")
    with open_work(folder / "finished.sqlite", ABOUT) as store:
        resumable_map(_square, range(8), store=store, name="squares")
    finish_work(folder / "finished.sqlite")
    (folder / "tiny.toml").write_text(TINY, encoding="utf-8")
    (folder / "start.toml").write_text("[front]\nstiffness_kN = 2.5\n", encoding="utf-8")
    return folder


ABOUT = {"inputs": {"data": "0" * 64}, "seed": 1, "settings": {"n_starts": 8, "bounds": [0.0, 1.5]}}
TINY = """format = 1
name = "tiny"
[[trials]]
flexion_deg = 0
internal_moment_Nm = 0.4
[[trials]]
flexion_deg = 8
anterior_force_N = 30
"""
PROTOCOLS = (
    TINY,
    """format = 1
name = "ramps"
description = "two of them"
[[ramps]]
flexion_deg = [0, 30.5]
load = "internal_moment_Nm"
values = [-4, 0, 4]
held = { distraction_force_N = -100 }
[[ramps]]
flexion_deg = 60
load = "lateral_force_N"
values = [10]
""",
)
STARTS = (
    "[ACL]\nstiffness_kN = 9.5\nreference_strain_pct = 7.5\n[MCL]\nstiffness_kN = 8\n",
    'PCL = { stiffness_kN = 12, reference_strain_pct = -1.5 }\n"LCL".stiffness_kN = 3e0\n',
)


def _square(x: int) -> dict[str, Any]:
    return {"theta": [float(x), x / 3.0], "outcome": "minimum", "objective": float(x * x)}


def _laxity() -> Laxity:
    protocol = small_protocol()
    values = np.random.default_rng(0).normal(size=(protocol.n, 5))
    plain = Laxity(protocol=protocol, coordinates=values, comments=("made up",))
    noisy = add_noise(plain, sd_mm=0.3, sd_deg=0.3, seed=0, correlation=0.1)
    return replace(
        noisy, order=np.arange(protocol.n), phase=("loading",) * protocol.n, zero="unloaded"
    )


def _truth() -> Truth:
    return Truth(
        seed=1,
        effects=("compression",),
        amplitudes={"compression": {"force_N": (40.0, "N"), "amplitude": (1.0, "1")}},
        theta={"ACL.stiffness_kN": 10.0, "ACL.reference_strain_pct": 8.0},
        signal=8.5,
        is_largest=False,
        lines={"compression": (np.array([0.0, 1.0, 2.0]), np.array([0.0, -9.0, 2.0]))},
        facts={"noise": "normal"},
    )


# --- readers ------------------------------------------------------------------------------------


def _of(*names: str) -> list[bytes]:
    return [(base() / x).read_bytes() for x in names]


def _mostly(structured: Callable[[Sequence[bytes]], Strategy], corpus: Sequence[bytes]) -> Strategy:
    """Changes that leave the form whole, and at times any."""
    return st.one_of(structured(corpus), structured(corpus), structured(corpus), texts(corpus))


def _subjects() -> Strategy:
    return _mostly(tomls, _of("subject/subject.toml"))


def _subject(content: bytes, folder: Path) -> str:
    shutil.copytree(base() / "subject", folder, dirs_exist_ok=True)
    (folder / "subject.toml").write_bytes(content)
    effects_of(read_subject(folder))
    return ""


def _surface(kind: str) -> Callable[[bytes, Path], str]:
    return reads(read_surface, f"surface.{kind}")


def _vtp(surface: Surface) -> bytes:
    own = np.zeros(len(surface.faces))
    none: list[IntArray] = []
    return polydata(surface.vertices, none, surface.faces, {"gap_mm": own}, {"trial": ["a"]})


def _ascii_stl() -> bytes:
    surface = read_surface(base() / "surface.stl")
    lines = ["solid x"]
    for face in surface.faces[:20]:
        lines += ["facet normal 0 1 0", "outer loop"]
        lines += [f"vertex {x:g} {y:g} {z:g}" for x, y, z in surface.vertices[face].tolist()]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid x", ""]).encode()


def _text_ply() -> bytes:
    surface = read_surface(base() / "surface.ply")
    vertices = [" ".join(map(str, x)) for x in surface.vertices.tolist()]
    faces = ["3 " + " ".join(map(str, x)) for x in surface.faces.tolist()]
    header = f"""ply
format ascii 1.0
element vertex {len(vertices)}
property float x
property float y
property float z
element face {len(faces)}
property list uchar int vertex_indices
end_header"""
    return "\n".join([header, *vertices, *faces, ""]).encode()


def _meshes(kind: str) -> Strategy:
    whole = _of(f"surface.{kind}")
    if kind == "obj":
        return _mostly(numbers, whole)
    if kind == "vtp":
        return st.one_of(binaries(whole), _mostly(elements, whole))
    written = [_ascii_stl() if kind == "stl" else _text_ply()]
    return st.one_of(binaries(whole), _mostly(numbers, written))


def _start(path: Path) -> object:
    names = ["ACL", "PCL", "LCL", "MCL"]
    return load_start(path, ligament_parameters(names, [10.0] * 4, [1.0] * 4))


def _osim(content: bytes, folder: Path) -> str:
    (folder / "Geometry").symlink_to(base() / "Geometry")
    (folder / "small.osim").write_bytes(content)
    import_opensim(folder / "small.osim")
    return ""


def _truths() -> Strategy:
    return st.one_of(texts(_of("truth.json")), trees(_of("truth.json")))


def _read_truth(path: Path) -> object:
    return read_truth(path.parent)


# --- unfinished work ----------------------------------------------------------------------------


def _resume(content: bytes, folder: Path) -> str:
    (folder / "work.sqlite").write_bytes(content)
    _resume_in(folder)
    return ""


def _resume_in(folder: Path) -> None:
    # Where it goes on is said, and no fault.
    with open_work(folder / "work.sqlite", ABOUT) as store, redirect_stderr(io.StringIO()):
        found = resumable_map(_square, range(8), store=store, name="squares")
    expected = [_square(x) for x in range(8)]
    if found != expected:
        raise AssertionError(f"went on from damaged work: {found}")


def _rows() -> Strategy:
    """Which row, which column, and its new value."""
    row, column = st.integers(0, 8), st.sampled_from(("key", "value", "checksum"))
    value = st.one_of(
        trees([b'{"theta": [1.0, 0.3], "outcome": "minimum", "objective": 1.0}']),
        texts([b'{"format": 1, "identknee": "0.1.0", "about": {"seed": 1}}', b"squares/3"]),
    )
    return st.tuples(row, column, value).map(
        lambda x: json.dumps([x[0], x[1], x[2].decode("latin-1")]).encode()
    )


def _change_row(content: bytes, folder: Path) -> str:
    row, column, value = json.loads(content)
    shutil.copy(base() / "store.sqlite", folder / "work.sqlite")
    with closing(sqlite3.connect(folder / "work.sqlite")) as other, other:
        other.execute(
            f"UPDATE OR REPLACE rows SET {column} = CAST(? AS TEXT) WHERE rowid = "
            "(SELECT rowid FROM rows LIMIT 1 OFFSET ?)",
            (value.encode("latin-1"), row),
        )
    _resume_in(folder)
    return ""


# --- results ------------------------------------------------------------------------------------


@cache
def _summaries() -> list[bytes]:
    return [(RESULTS / x / "result.json").read_bytes() for x in VERBS]


def _page(folder: Path) -> str:
    if not report_html(found_results(folder)).endswith("</html>\n"):
        raise AssertionError("the page is not whole")
    return ""


def _summary(content: bytes, folder: Path) -> str:
    (folder / "result.json").write_bytes(content)
    return _page(folder)


def _drawn() -> Strategy:
    """A verb and its changed summary, to be told and drawn with its arrays."""
    verb = st.sampled_from(VERBS)
    return verb.flatmap(
        lambda x: trees([(RESULTS / x / "result.json").read_bytes()]).map(
            lambda content: f"{x}\n".encode() + content
        )
    )


def draw_page(content: bytes, folder: Path) -> str:
    verb, _, summary = content.partition(b"\n")
    shutil.copy(RESULTS / verb.decode() / "result.nc", folder)
    (folder / "result.json").write_bytes(summary)
    return _page(folder)


def _damaged() -> Strategy:
    """A verb and its changed arrays."""
    return st.sampled_from(VERBS).flatmap(
        lambda x: binaries([(RESULTS / x / "result.nc").read_bytes()]).map(
            lambda content: f"{x}\n".encode() + content
        )
    )


def _damage(content: bytes, folder: Path) -> str:
    verb, _, arrays = content.partition(b"\n")
    shutil.copy(RESULTS / verb.decode() / "result.json", folder)
    (folder / "result.nc").write_bytes(arrays)
    return _page(folder)


def _edits() -> Strategy:
    """A verb and what is done to a variable of its arrays, which then pass for whole."""
    return st.tuples(
        st.sampled_from(VERBS),
        st.integers(0, 400),
        st.sampled_from(("drop", "nan", "huge", "inf", "zero", "negative", "same", "text", "half")),
    ).map(lambda x: json.dumps(x).encode())


def _edit(content: bytes, folder: Path) -> str:
    import xarray

    verb, number, kind = json.loads(content)
    with xarray.open_datatree(RESULTS / verb / "result.nc", engine="netcdf4") as tree:
        groups = {x: node.to_dataset().load() for x, node in tree.children.items()}
    places = [(group, name) for group, data in groups.items() for name in data.variables]
    group, name = places[number % len(places)]
    groups[group] = _edited(groups[group], name, kind)
    xarray.DataTree.from_dict(groups).to_netcdf(folder / "result.nc", engine="netcdf4")
    summary = json.loads((RESULTS / verb / "result.json").read_text(encoding="utf-8"))
    summary["record"]["arrays"] = digest(folder / "result.nc")
    (folder / "result.json").write_text(json.dumps(summary), encoding="utf-8")
    return _page(folder)


def _edited(data: Any, name: Any, kind: str) -> Any:
    values = np.array(data[name].values)
    if kind == "drop":
        return data.drop_vars(name)
    if kind == "half" and data[name].dims:
        axis = data[name].dims[0]
        return data.isel({axis: slice(0, data.sizes[axis] // 2)})
    if kind == "text" or values.dtype.kind not in "fiu":
        return data.assign({name: (data[name].dims, np.full(values.shape, "x"))})
    if kind == "same":
        values[...] = values.ravel()[0] if values.size else 0
    else:
        number = {"nan": np.nan, "huge": 1e300, "inf": np.inf, "zero": 0.0}.get(kind, -1.0)
        values = np.full(values.shape, number)
    return data.assign({name: (data[name].dims, values)})


def _reveal(content: bytes, folder: Path) -> str:
    (folder / "result.json").write_bytes(content)
    shutil.copy(RESULTS / "diagnose" / "result.nc", folder)
    return commanded(["reveal", str(base()), str(folder)])


def _diagnoses() -> Strategy:
    whole = (RESULTS / "diagnose" / "result.json").read_bytes()
    return trees([whole])


# --- calls --------------------------------------------------------------------------------------

# Verbs that end soon on two trials; each value may become another of its kind, or anything.
QUICK: Sequence[str] = (
    "simulate SMALL --protocol TINY --set front.stiffness_kN=2 --seed 1",
    "simulate SMALL --protocol TINY --noise 0.3mm,0.3deg --seed 1",
    "simulate SMALL --protocol TINY --noise 1mm,1deg --noise-correlation 0.1",
    "simulate SMALL --protocol TINY --noise 1mm,1deg --noise-student 4",
    "simulate SMALL --protocol TINY --continuation single-step --contact field",
    "fit SMALL DATA --start subject --budget 5 --weighting noise",
    "fit SMALL DATA --method complex --budget 5 --fix front.stiffness_kN",
    "fit SMALL DATA --bounds front.stiffness_kN=1:5 --budget 3",
    "sweep SMALL DATA --n-starts 2 --budget 3 --paths 0",
    "subject check SMALL --protocol TINY --samples 2",
    "subject export SMALL",
    "sensitivity SMALL --protocol TINY --method morris --samples 2",
    "report RESULT",
    "reveal BLIND RESULT",
    "doctor",
)
FIXED = "--fix back.stiffness_kN --fix outer.stiffness_kN --fix inner.stiffness_kN"
LONG: Sequence[str] = (
    f"profile SMALL DATA {FIXED} --parameter front.stiffness_kN --noise 0.3mm,0.3deg",
    f"information SMALL DATA {FIXED} --noise 0.3mm,0.3deg",
    f"equivalents SMALL DATA {FIXED} --n-sets 2 --criterion paper --forces none",
    f"design SMALL DATA {FIXED} --n-trials 1 --target front.stiffness_kN --candidates TINY",
    "diagnose SMALL DATA --noise 0.3mm,0.3deg",
    f"sample SMALL DATA {FIXED} --ensembles 2 --budget 200",
)
_NUMBERS = ("0", "-1", "1e-300", "1e300", "nan", "inf", "0.5", "2", "40", "1e17", "-0.25", "x")
_NAMES = ("front.stiffness_kN", "back.reference_strain_pct", "front", "ACL.stiffness_kN", "")
_COUNTS = ("0", "-1", "1", "2", "3", "9" * 30, "9" * 5000, "1.5", "")
_SIZES = (
    "0.3mm,0.3deg",
    "1e-300mm,1deg",
    "1e300mm,1deg",
    "1deg,2mm",
    "0mm,1deg",
    "nanmm,1deg",
    "1mm",
)
# What may stand in the place of a value of each option; any other option takes a number.
KINDS: Mapping[str, Sequence[str]] = {
    "--protocol": ("TINY", "drawer", "DATA", "SMALL", "nothing", "", "SUBJECT"),
    "--candidates": ("TINY", "nothing"),
    "--noise": _SIZES,
    "--start": ("subject", "IG1", "IG9", "TINY", "nothing.toml", "START"),
    "--method": ("least-squares", "complex", "morris", "sobol", "genetic", "x"),
    "--weighting": ("unit", "noise", "x"),
    "--continuation": ("continuation", "single-step", "x"),
    "--contact": ("field", "mesh", "x"),
    "--criterion": ("noise", "paper", "width", "x"),
    "--set": tuple(f"{x}={y}" for x in _NAMES for y in _NUMBERS),
    "--bounds": tuple(f"{x}={y}:{z}" for x in _NAMES[:2] for y in _NUMBERS for z in _NUMBERS),
    **dict.fromkeys(("--fix", "--parameter", "--target"), _NAMES),
    **dict.fromkeys(
        ("--seed", "--budget", "--n-starts", "--paths", "--samples", "--n-sets", "--n-trials"),
        _COUNTS,
    ),
    "": ("SMALL", "DATA", "RESULT", "BLIND", "TINY", "nothing", "/dev/null", "s192803", "SUBJECT"),
}
NO_FOLDER = ("report", "reveal", "doctor")


def _calls(calls: Sequence[str]) -> Strategy:
    return st.sampled_from(calls).flatmap(lambda x: _changed_call(x.split()))


def _changed_call(call: Sequence[str]) -> Strategy:
    """Mostly a value is another of its kind; or any word is any, is left out or doubled."""
    values = [i for i, x in enumerate(call) if i > 0 and not x.startswith("--")] or [0]
    of_its_kind = st.sampled_from(values).flatmap(
        lambda i: st.tuples(st.just(i), st.sampled_from(_kind(call, i)), st.just(2))
    )
    anything = st.tuples(
        st.integers(0, len(call) - 1),
        st.one_of(st.sampled_from(PLAIN), texts([x.encode() for x in call]).map(_text)),
        st.integers(0, 4),
    )
    return st.one_of(of_its_kind, of_its_kind, of_its_kind, anything).map(
        lambda x: json.dumps(_call(list(call), *x)).encode()
    )


def _kind(call: Sequence[str], i: int) -> Sequence[str]:
    before = call[i - 1]
    return KINDS.get(before if before.startswith("--") else "", _NUMBERS)


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


def _call(words: list[str], at: int, word: str, kind: int) -> list[str]:
    if kind == 0:
        return [*words[:at], *words[at + 1 :]]
    if kind == 1:
        return [*words[:at], word, *words[at:]]
    return [*words[:at], word, *words[at + 1 :]]


def _command(content: bytes, folder: Path) -> str:
    places: Mapping[str, Path] = {
        "SMALL": base() / "small",
        "TINY": base() / "tiny.toml",
        "DATA": base() / "tiny.csv",
        "RESULT": RESULTS / "profile",
        "BLIND": base(),
        "SUBJECT": base() / "subject" / "subject.toml",
        "START": base() / "start.toml",
    }
    _data()
    words = [str(places.get(x, x)).replace("\0", "") for x in json.loads(content)]
    out = folder / "out"
    if words[:1] == ["report"]:
        words += ["--out", str(out / "report.html")]
    elif not set(words[:1]) & set(NO_FOLDER):
        words += ["--out", str(out)]
    return commanded(words, out)


@cache
def _data() -> Path:
    """Laxity of the small knee on the tiny protocol."""
    knee, protocol = read_subject(base() / "small"), load_protocol(base() / "tiny.toml")
    model = LaxityModel(knee=knee, protocol=protocol)
    laxity = model.simulate(model.parameters.center)
    noisy = add_noise(laxity, sd_mm=0.3, sd_deg=0.3, seed=0)
    return write_laxity(noisy, base() / "tiny.csv")


TARGETS: Sequence[Target] = (
    Target(name="subject.toml", share=120, run=_subject, inputs=_subjects),
    *(
        Target(name=f"mesh {x}", share=55, run=_surface(x), inputs=lambda x=x: _meshes(x))  # type: ignore[misc]
        for x in ("stl", "ply", "obj", "vtp")
    ),
    Target(
        name="protocol TOML",
        share=140,
        run=reads(load_protocol, "some.toml"),
        inputs=lambda: _mostly(tomls, [x.encode() for x in PROTOCOLS]),
    ),
    Target(
        name="laxity CSV",
        share=140,
        run=reads(read_laxity, "data.csv"),
        inputs=lambda: _mostly(tables, _of("data.csv")),
    ),
    Target(
        name="start TOML",
        share=100,
        run=reads(_start, "start.toml"),
        inputs=lambda: _mostly(tomls, [x.encode() for x in STARTS]),
    ),
    Target(
        name="osim XML", share=55, run=_osim, inputs=lambda: _mostly(elements, _of("small.osim"))
    ),
    Target(name="truth.json", share=30, run=reads(_read_truth, "truth.json"), inputs=_truths),
    Target(name="reveal", share=30, run=_reveal, inputs=_diagnoses),
    Target(
        name="store file",
        share=40,
        run=_resume,
        inputs=lambda: binaries(_of("store.sqlite", "finished.sqlite")),
    ),
    Target(name="store rows", share=40, run=_change_row, inputs=_rows),
    Target(name="result.json", share=100, run=_summary, inputs=lambda: trees(_summaries())),
    Target(name="result.json text", share=20, run=_summary, inputs=lambda: texts(_summaries())),
    Target(name="result.nc", share=20, run=_damage, inputs=_damaged),
    Target(name="result.json drawn", share=4, run=draw_page, inputs=_drawn),
    Target(name="result.nc edited", share=5, run=_edit, inputs=_edits),
    Target(name="quick verbs", share=26, run=_command, inputs=lambda: _calls(QUICK)),
    Target(name="long verbs", share=2, run=_command, inputs=lambda: _calls(LONG)),
)
