"""The knee in every trial for ParaView and PyVista: contact on its faces, forces on its lines."""

from pathlib import Path

import numpy as np

from identknee.mechanics.closest_point import mesh_distance
from identknee.mechanics.contact_law import ContactLaw
from identknee.mechanics.contact_places import distances
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.ligament_tensions import ligament_tensions, line_lengths
from identknee.mechanics.placement import Placement, place
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import Array
from identknee.runs.files import prepare_folder, write_atomically
from identknee.runs.vtk_files import collection, polydata
from identknee.subject.opensim_export import file_name

COLLECTION = "trials.pvd"
BONES = ("femur", "medial tibia", "lateral tibia")


def write_poses(model: LaxityModel, theta: Array, folder: Path) -> Path:
    """Path of a collection with the knee in every trial that has a stable pose, one file each.

    The femur stays where it was scanned. Faces have ``gap_mm``, their distance from the other bone
    (negative where they overlap), and ``pressure_MPa`` by the contact law of the model. Lines have
    ``tension_N`` and ``strain_pct``. ``part`` counts the bones and then the lines; what it stands
    for is in the field ``parts``.

    Parameters
    ----------
    model
        Any laxity model.
    theta
        Its parameter vector, shape ``(p,)``.
    folder
        Where to write, made if it is not there.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    prediction = model.predict(theta, derivatives=False)
    poses = _Poses(model, theta, prediction.poses)
    target, names = prepare_folder(folder), []
    for i in np.flatnonzero(prediction.is_converged):
        name = file_name(f"{i + 1:03d}_{model.protocol.trials[i]}", ".vtp")
        write_atomically(target / name, poses.file(int(i)))
        names.append(name)
    return write_atomically(target / COLLECTION, collection(names))


class _Poses:
    """What all trials of a model share, and the file of each."""

    def __init__(self, model: LaxityModel, theta: Array, poses: Array) -> None:
        self._model, self._poses = model, poses
        knee, setting = model.knee, model.setting(theta)
        contact, self._field = model.surfaces(setting)
        self._law = contact.law or ContactLaw()
        self._flexion = setting.flexion[model.paths.trial_node]
        self._lines = setting.measured_lines
        femur = knee.femur_frame.to_local(knee.femur.vertices)
        self._femur = setting.as_measured_points(femur, 0)
        tibia = [knee.tibia_frame.to_local(x.vertices) for x in knee.tibia]
        self._tibia = [setting.as_measured_points(x, 1) for x in tibia]
        self._to_sheets = [
            mesh_distance(own, x.faces) for own, x in zip(self._tibia, knee.tibia, strict=True)
        ]
        self._stiffness, self._strain = setting.stiffness, setting.reference_strain

    def file(self, trial: int) -> bytes:
        """Content of the file of a trial."""
        knee = self._model.knee
        placement = place(float(self._flexion[trial]), self._poses[trial])
        lines = np.asarray(self._lines.femoral), placement.to_femur(np.asarray(self._lines.tibial))
        n = len(lines[0])
        sheets = [self._femur, *(placement.to_femur(x) for x in self._tibia)]
        starts = np.cumsum([2 * n, *(len(x) for x in sheets)])
        surfaces = (knee.femur, *knee.tibia)
        # The scan of a left knee is seen in a mirror, which turns its triangles round.
        order = slice(None, None, -1 if knee.side == "left" else 1)
        triangles = [x.faces[:, order] + i for x, i in zip(surfaces, starts[:-1], strict=True)]
        gaps = np.concatenate(self._gaps(placement))
        places = np.concatenate([*lines, *sheets])
        numbers = [np.full(len(x.faces), i) for i, x in enumerate(surfaces)]
        empty, none = np.full(n, np.nan), np.full(len(gaps), np.nan)
        tension, strain = self._pulled(trial)
        return polydata(
            knee.as_scanned(knee.femur_frame.to_common(self._field.to_field(places))),
            np.column_stack([np.arange(n), n + np.arange(n)]),
            np.concatenate(triangles),
            {
                "part": np.concatenate([len(BONES) + np.arange(n), *numbers]),
                "gap_mm": np.r_[empty, gaps],
                "pressure_MPa": np.r_[empty, self._pressure(gaps)],
                "tension_N": np.r_[tension, none],
                "strain_pct": np.r_[strain, none],
            },
            {"parts": [*BONES, *self._names(n)], "trial": [self._model.protocol.trials[trial]]},
        )

    def _names(self, n: int) -> list[str]:
        own = [x.name for x in self._model.knee.ligaments]
        return [*own, *(f"line {i + 1} of effects" for i in range(n - len(own)))]

    def _gaps(self, placement: Placement) -> list[Array]:
        """Distance of the centre of each face from the other bone [mm], by bone."""
        knee = self._model.knee
        femoral = placement.to_tibia(self._femur[knee.femur.faces].mean(axis=1))
        to_tibia = np.min([distance(femoral) for distance in self._to_sheets], axis=0)
        tibial = [
            placement.to_femur(own[x.faces].mean(axis=1))
            for own, x in zip(self._tibia, knee.tibia, strict=True)
        ]
        return [to_tibia, *(_to_femur(self._field, x) for x in tibial)]

    def _pressure(self, gaps: Array) -> Array:
        return self._law.pressure(np.nan_to_num(-gaps, nan=-np.inf))[0]

    def _pulled(self, trial: int) -> tuple[Array, Array]:
        """Tension [N] and strain [%] of every line."""
        pose, flexion = self._poses[trial : trial + 1], self._flexion[trial : trial + 1]
        found = ligament_tensions(self._lines, flexion, pose, self._stiffness, self._strain)
        length = line_lengths(self._lines, float(flexion[0]), pose[0])
        slack = np.asarray(self._lines.reference_length) / (1.0 + self._strain)
        return found.tensions[0], 100.0 * (length / slack - 1.0)


def _to_femur(field: DistanceField, places: Array) -> Array:
    """Distance of places from the femur [mm]; NaN beyond the grid of the field."""
    places = field.to_field(places)
    cell = np.floor((places - field.origin) / field.spacing)
    # The outermost cells of the grid lack the support of the spline.
    inner = ((cell >= 1) & (cell <= np.array(field.coefficients.shape) - 3)).all(axis=1)
    found = np.full(len(places), np.nan)
    found[inner] = distances(field, places[inner])[0]
    return found
