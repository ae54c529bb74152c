import numpy as np
import pytest
from data_files import stored

from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee

SURFACE = 1e-9  # mm; how exact the distance is to be near the surface


def test_size(reference: Knee) -> None:
    assert sum(len(x.vertices) for x in reference.tibia) == 1550
    medial, lateral = (x.areas.sum() for x in reference.tibia)
    assert medial == pytest.approx(1052.0, abs=1.0)
    assert lateral == pytest.approx(966.0, abs=1.0)
    assert reference.side == "right"


def test_femur_is_the_zero_of_its_distance(reference: Knee) -> None:
    distance = reference.femur_distance
    assert distance is not None
    assert np.abs(distance(reference.femur.vertices)).max() < SURFACE
    centres = reference.femur.vertices[reference.femur.faces].mean(axis=1)
    # Faces of a convex surface lie inside it, by 0.008 mm at an edge of 0.8 mm.
    inside = -distance(centres)
    assert inside.min() > -1e-3
    assert inside.max() < 0.01
    assert (distance(centres + reference.femur.normals) > 0.9).all()


def test_gradient_of_the_distance(reference: Knee) -> None:
    distance = reference.femur_distance
    assert distance is not None
    generator = np.random.default_rng(1)
    points = generator.choice(reference.femur.vertices, 500) + generator.normal(size=(500, 3))
    step = 1e-4
    gradient = np.stack(
        [
            (distance(points + move) - distance(points - move)) / (2 * step)
            for move in step * np.eye(3)
        ]
    )
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=0), 1.0, atol=1e-7)


def test_edges_follow_what_is_asked() -> None:
    coarse = reference_knee(3.0, femur_edge_mm=2.0)
    edges = coarse.femur.vertices[coarse.femur.edges]
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert np.median(lengths) == pytest.approx(2.0, rel=0.25)
    assert sum(len(x.vertices) for x in coarse.tibia) < 300
    with pytest.raises(ValueError, match=r"0\.2 to 10 mm"):
        reference_knee(0.01)


def test_numbers_are_the_documented_ones(reference: Knee) -> None:
    documented = stored("reference_knee.json")
    for ligament in reference.ligaments:
        entry = documented["ligaments"][ligament.name]
        assert ligament.femur.tolist() == entry["femur"]["value"]
        assert ligament.tibia.tolist() == entry["tibia"]["value"]
        assert ligament.stiffness_kN == entry["stiffness"]["value"]
        assert ligament.reference_strain_pct == entry["reference_strain"]["value"]
        # Written there with three decimals.
        assert ligament.length == pytest.approx(entry["reference_length"]["value"], abs=5e-4)
    for surface, side in zip(reference.tibia, ("medial", "lateral"), strict=True):
        x, y, z = surface.vertices.T
        t = {key: entry["value"] for key, entry in documented["tibia"][side].items()}
        dx, dz = x - t["xc"], z - t["zc"]
        height = (
            t["yc"]
            + np.tan(np.radians(t["slope"])) * dx
            + np.tan(np.radians(t["tilt"])) * dz
            + t["kx"] * dx**2 / 2
            + t["kz"] * dz**2 / 2
        )
        bump = ((x - t["em_x"]) / t["em_sx"]) ** 2 + ((z - t["em_z"]) / t["em_sz"]) ** 2
        np.testing.assert_allclose(y, height + t["em_h"] * np.exp(-bump / 2), atol=1e-12)
