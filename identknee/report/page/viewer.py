"""The knee in three dimensions as HTML for a page that is read offline."""

import html
import json
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from identknee.report.page.few_triangles import Mesh
from identknee.report.page.knee_scene import KneeScene, SceneTrial, model_scene
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

__all__ = ["KneeScene", "model_scene", "viewer_html"]

MICROMETRES = 1000.0  # in a mm
MARGIN = 8.0  # mm around what is drawn, room for names
SHAFT = 38.0  # mm, length of the strokes that stand for the bones' shafts


def viewer_html(scene: KneeScene) -> str:
    """HTML of the interactive knee: a fragment that needs `Plotly` on its page and nothing else.

    A left knee is drawn as a left one. A page may hold several of them.
    """
    here = files("identknee.report.page")
    page, style, code = ((here / f"viewer.{x}").read_text("utf-8") for x in ("html", "css", "js"))
    data = json.dumps(_data(scene), separators=(",", ":"), allow_nan=False)
    return Template(page).substitute(
        style=style,
        code=code,
        # Nothing in the data can end the element that holds them.
        data=data.replace("<", "\\u003c"),
        words=html.escape(_in_words(scene)),
        last=len(scene.trials) - 1,
        hidden=" hidden" if len(scene.trials) == 1 else "",
    )


def _data(scene: KneeScene) -> dict[str, Any]:
    """What the drawing is made from, of the knee's own side."""
    mirror = np.array([1.0, 1.0, -1.0 if scene.knee.side == "left" else 1.0])
    lines = scene.lines
    forces = np.array([x.tensions for x in scene.trials])
    depths = np.concatenate([x.depths for x in scene.trials])
    missing = scene.missing_line
    return {
        "lateral": mirror[2],
        "femur": _mesh(scene.femur, mirror),
        "tibia": _mesh(scene.tibia, mirror),
        "lines": [
            {
                "name": name,
                "femoral": _rounded(lines.femoral[i] * mirror, 3),
                "tibial": _rounded(lines.tibial[i] * mirror, 3),
                "lift": _rounded(np.asarray(lines.wrap_offset)[i] * mirror[2], 3),
                "place": _rounded(np.asarray(lines.wrap_place)[i], 4),
            }
            for i, name in enumerate(scene.names)
        ],
        "missing": None if missing is None else _rounded(missing * mirror, 3),
        "shafts": _rounded(_shafts(scene) * mirror, 2),
        "box": _rounded(_box(scene, mirror), 1),
        "force": float(np.nanmax(np.abs(forces), initial=1.0)),
        "depth": float(np.max(depths, initial=0.01).round(2)),
        "trials": [_trial(x, mirror) for x in scene.trials],
    }


def _mesh(mesh: Mesh, mirror: Array) -> dict[str, Any]:
    x, y, z = (mesh.vertices * mirror).T.tolist()
    i, j, k = (mesh.faces if mirror[2] > 0.0 else mesh.faces[:, ::-1]).T.tolist()
    return {"x": x, "y": y, "z": z, "i": i, "j": j, "k": k}


def _trial(trial: SceneTrial, mirror: Array) -> dict[str, Any]:
    placement = trial.placement
    is_converged = trial.outcome is Outcome.CONVERGED
    return {
        "name": trial.name,
        "loads": trial.loads,
        "outcome": None if is_converged else trial.outcome.sentence,
        # A mirror before and after leaves a rotation.
        "rotation": _rounded(mirror[:, None] * placement.rotation * mirror, 8),
        "translation": _rounded(placement.translation * mirror, 5),
        "coordinates": _rounded(trial.coordinates, 2),
        "forces": [None if np.isnan(x) else round(float(x), 2) for x in trial.tensions],
        "near": trial.near.tolist(),
        "depths": np.round(MICROMETRES * trial.depths).astype(int).tolist(),
    }


def _shafts(scene: KneeScene) -> Array:
    """Ends of a stroke up the femur and of one down the tibia [mm], shape ``(2, 2, 3)``."""
    top = scene.femur.vertices[:, 1].max()
    bottom = scene.tibia.vertices[:, 1].min()
    ends = [
        [[0.0, top, 0.0], [0.0, top + SHAFT, 0.0]],
        [[0.0, bottom, 0.0], [0, bottom - SHAFT, 0]],
    ]
    return np.array(ends)


def _box(scene: KneeScene, mirror: Array) -> Array:
    """Lowest and highest corner of all that is drawn in any trial [mm], shape ``(2, 3)``."""
    missing = np.zeros((0, 2, 3)) if scene.missing_line is None else scene.missing_line[None]
    shafts = _shafts(scene)
    femoral = [scene.femur.vertices, scene.lines.femoral, missing[:, 0], shafts[0]]
    tibial = [scene.tibia.vertices, scene.lines.tibial, missing[:, 1], shafts[1]]
    moving = np.concatenate(tibial)
    places = np.concatenate([*femoral, *(x.placement.to_femur(moving) for x in scene.trials)])
    seen = places * mirror
    return np.stack([seen.min(axis=0) - MARGIN, seen.max(axis=0) + MARGIN])


def _rounded(values: Array, decimals: int) -> Any:
    """Numbers as nested lists, short in the file."""
    return (np.round(values, decimals) + 0.0).tolist()


def _in_words(scene: KneeScene) -> str:
    """Alternative text of the interactive figure."""
    forces = np.array([x.tensions for x in scene.trials])
    knee, n = scene.knee, len(scene.trials)
    said = [f"The {knee.side} knee {knee.name} in {n} trials, its ligaments coloured by force."]
    if np.isfinite(forces).any():
        trial, line = np.unravel_index(np.nanargmax(forces), forces.shape)
        said.append(
            f"The largest force is {forces[trial, line]:.0f} N, of {scene.names[line]} in "
            f"{scene.trials[trial].name}."
        )
    lost = [x.name for x in scene.trials if x.outcome is not Outcome.CONVERGED]
    if lost:
        said.append(f"{len(lost)} without equilibrium, the first of them {lost[0]}.")
    return " ".join(said)
