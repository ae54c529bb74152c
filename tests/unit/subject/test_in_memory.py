"""A knee from a data frame of insertions and meshes in memory."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import trimesh

import identknee as ik
from identknee.subject.folder import NAME
from identknee.subject.surface import write_surface
from identknee.verbs.verb import knee_digest

LIKE = ik.reference_knee(edge_mm=3.0)
MESHES = {"femur": LIKE.femur, "tibia_medial": LIKE.tibia[0], "tibia_lateral": LIKE.tibia[1]}


def ligaments(knee: ik.Knee = LIKE) -> pd.DataFrame:
    rows = {
        x.name: {
            **{
                f"{bone}_{axis}_mm": place[k]
                for bone, place in (("femur", x.femur), ("tibia", x.tibia))
                for k, axis in enumerate("xyz")
            },
            "stiffness_kN": x.stiffness_kN,
            "reference_strain_pct": x.reference_strain_pct,
        }
        for x in knee.ligaments
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def tables(**more: Any) -> dict[str, Any]:
    frames = {
        bone: {"origin": own.origin, "axes": own.axes}
        for bone, own in (("femur", LIKE.femur_frame), ("tibia", LIKE.tibia_frame))
    }
    made = {
        "name": "mine",
        "side": "right",
        "surfaces": MESHES,
        "frames": frames,
        "ligaments": ligaments(),
    }
    return made | more


def read_back(folder: Path, knee: ik.Knee) -> ik.Knee:
    return ik.read_subject(ik.write_subject(knee, folder))


@pytest.mark.parametrize("form", ["surface", "arrays", "trimesh", "path"])
def test_the_knee_is_that_of_the_same_folder(form: str, tmp_path: Path) -> None:
    def shown(name: str) -> Any:
        own = MESHES[name]
        return {
            "surface": own,
            "arrays": (own.vertices.tolist(), own.faces),
            "trimesh": trimesh.Trimesh(own.vertices, own.faces, process=False),
            "path": tmp_path / f"{name}.ply",
        }[form]

    for name, surface in MESHES.items():
        write_surface(surface, tmp_path / f"{name}.ply")
    knee = ik.read_subject(tables(surfaces={x: shown(x) for x in MESHES}))
    assert knee_digest(knee) == knee_digest(read_back(tmp_path / "knee", knee))
    assert [x.name for x in knee.ligaments] == [x.name for x in LIKE.ligaments]
    for one, other in zip(knee.ligaments, LIKE.ligaments, strict=True):
        np.testing.assert_allclose(one.femur, other.femur)
        np.testing.assert_allclose(one.tibia, other.tibia)
    np.testing.assert_array_equal(knee.femur.vertices, LIKE.femur.vertices)
    laxity = ik.simulate(knee, "drawer").laxity.coordinates
    np.testing.assert_allclose(laxity, ik.simulate(LIKE, "drawer").laxity.coordinates, atol=0.3)


def test_whatever_a_file_may_state_may_stand_there() -> None:
    more = {
        "uncertainty": {"insertions_mm": np.float64(2.0)},
        "bounds": {"ACL.stiffness_kN": (1, 9)},
    }
    knee = ik.read_subject(tables(**more))
    assert knee.uncertainty.insertions_mm == 2.0
    assert knee.bounds["ACL.stiffness_kN"] == (1.0, 9.0)
    left = ik.read_subject(
        tables(side="left", surfaces=_mirrored(), ligaments=_mirrored_ligaments())
    )
    assert left.side == "left"


def _mirrored() -> dict[str, Any]:
    return {name: x.mirrored() for name, x in MESHES.items()}


def _mirrored_ligaments() -> pd.DataFrame:
    frame = ligaments()
    for bone in ("femur", "tibia"):
        frame[f"{bone}_z_mm"] *= -1.0
    return frame


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"surfaces": {**MESHES, "femur": 7}}, "surface femur: int is not a mesh. Give a path"),
        (
            {"surfaces": {**MESHES, "femur": ([[0, 0, 0]], [[0, 1, 2]])}},
            "surface femur: faces must",
        ),
        ({"ligaments": ligaments().drop(columns="tibia_y_mm")}, "no column tibia_y_mm"),
        ({"colour": "red"}, "there is no key 'colour' here"),
        ({"side": "top"}, "'top' is not a side"),
        ({"surfaces": {"femur": LIKE.femur}}, "'tibia_medial' is missing"),
        ({"ligaments": ligaments().assign(stiffness_kN=-1.0)}, "stiffness of ACL must be finite"),
    ],
)
def test_a_mistake_is_named_with_its_remedy(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(ik.InputError) as caught:
        ik.read_subject(tables(**changed))
    assert caught.value.path == NAME
    assert said in str(caught.value)
