"""A knee with what a result found of it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from identknee.checks.usable_trials import table_model
from identknee.model.nuisances import contact_rounding, insertions
from identknee.model.parameter_groups import tied
from identknee.model.parameters import STIFFNESS, STRAIN
from identknee.runs.declare import Array
from identknee.subject.knee import AXES, BONES, EffectChoice, Knee, with_stated_uncertainty
from identknee.verbs.answer import Answer
from identknee.verbs.verb import knee_digest

INSERTION = "insertion"


def fitted_knee(knee: Knee, answer: Answer) -> Knee:
    """The knee with the ligaments, and the amplitudes of its own effects, that a result found.

    Insertions that were taken as uncertain are where the result has them. What else was uncertain
    is an error of frames or tests, and stays out of the knee.

    Raises
    ------
    ValueError
        If the result is of another knee, or holds no parameter set.
    """
    values = fitted_values(answer)
    stated = with_stated_uncertainty_of(knee, answer)
    data = getattr(answer, "data", None)
    # The fit may have kept another pattern of the grouped bundles.
    pattern = knee if data is None else table_model(knee, data)[0].knee
    found = _with_values(knee, values, stated, pattern)
    return replace(found, contact_rounding_mm=contact_rounding(stated))


def knee_as_fitted(knee: Knee) -> Knee:
    """The knee of a folder that a fit left, with parameters and insertions found; else as it is."""
    found = _with_values(knee, knee.fitted, knee, knee) if knee.fitted else knee
    moved = next((x for x in found.effects if x.name == INSERTION), None)
    if moved is None:
        return found
    shifts = [
        [[moved.values.get(f"{x.name}_{bone}_{axis}_mm", 0.0) for axis in AXES] for bone in BONES]
        for x in found.ligaments
    ]
    others = [x for x in found.effects if x is not moved]
    return _with_moved_ends(found, np.array(shifts)).with_effects(others)


def _with_values(knee: Knee, values: Mapping[str, float], stated: Knee, pattern: Knee) -> Knee:
    """The knee at `values`, uncertain as `stated`, its bundles related as those of `pattern`."""
    shifts = _insertion_shifts(stated, values)
    units = tied(pattern)
    own = zip(
        units.names, units.stiffness_kN.tolist(), units.reference_strain_pct.tolist(), strict=True
    )
    found = [(values.get(f"{x}.{STIFFNESS}", k), values.get(f"{x}.{STRAIN}", e)) for x, k, e in own]
    stiffness, strain = np.array(found).T
    stiffness, strain = (units.stiffness(stiffness).tolist(), units.strain(strain).tolist())
    ligaments = [
        replace(x, stiffness_kN=own_stiffness, reference_strain_pct=own_strain)
        for x, own_stiffness, own_strain in zip(knee.ligaments, stiffness, strain, strict=True)
    ]
    effects = [_fitted_effect(x, values) for x in knee.effects]
    return _with_moved_ends(knee.with_ligaments(ligaments), shifts).with_effects(effects)


def _with_moved_ends(knee: Knee, shifts: Array) -> Knee:
    """The knee with both ends of every ligament moved along the axes of their bones [mm]."""
    moved = [
        replace(
            x,
            femur=x.femur + shift[0] @ knee.femur_frame.axes,
            tibia=x.tibia + shift[1] @ knee.tibia_frame.axes,
        )
        for x, shift in zip(knee.ligaments, shifts, strict=True)
    ]
    return knee.with_ligaments(moved)


def fitted_values(answer: Answer) -> dict[str, float]:
    """The parameters that a result found, by name.

    Raises
    ------
    ValueError
        If the result holds no parameter set.
    """
    if answer.parameter_set is not None:
        return dict(answer.parameter_set)
    raise ValueError(
        f"a result of type {type(answer).__name__} holds no parameter set; give one of fit, "
        "profile or simulate"
    )


def with_stated_uncertainty_of(knee: Knee, answer: Answer) -> Knee:
    """The knee of a result, with the uncertainty that the call stated in place of its own.

    Raises
    ------
    ValueError
        If the result is of another knee.
    """
    if answer.record is None:
        return knee
    stated = answer.record.settings.get("uncertain")
    if stated is not None:
        knee = knee.with_uncertainty(with_stated_uncertainty(knee.uncertainty, stated))
    if answer.record.inputs.get("subject") != knee_digest(knee):
        raise ValueError(
            f"the result is not of {knee.name} as it is now; give the subject that it was made with"
        )
    return knee


def _insertion_shifts(knee: Knee, values: Mapping[str, float]) -> Array:
    """Shifts of both ends of every ligament along the axes of their bones [mm], ``(n, 2, 3)``."""
    shape = (len(knee.ligaments), 2, 3)
    spread = knee.uncertainty.insertions_mm
    is_own = any(x.name == INSERTION for x in knee.effects)
    if is_own or (isinstance(spread, float) and spread == 0.0):
        return np.zeros(shape)
    nuisance = insertions(knee)
    found = np.array([values.get(x, 0.0) for x in nuisance.parameters.names])
    return np.asarray((nuisance.matrix @ found).reshape(shape))


def _fitted_effect(choice: EffectChoice, values: Mapping[str, float]) -> EffectChoice:
    start = f"{choice.name}."
    found = {x.removeprefix(start): value for x, value in values.items() if x.startswith(start)}
    return replace(choice, values={**choice.values, **found}) if found else choice
