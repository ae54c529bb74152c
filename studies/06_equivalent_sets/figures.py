"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.figure import Figure
from paper_forces import PAPER_LIGAMENTS, PAPER_TABLE6, PAPER_TABLE7

import identknee as ik

PAPER = "paper"
NOISE = "0.5 mm, 0.5 deg"
TITLES = {
    "anterior_drawer_mm": "anterior drawer [mm]",
    "varus_deg": "varus [deg]",
    "internal_deg": "internal rotation [deg]",
}
MARKS = {"bound": "\\*", "cliff": "†", "budget": "‡"}
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure | None:
    """Sets that noise of 0.5 mm and deg hides, on the first knee."""
    return _sets(record, NOISE)


def figure_2(record: Row) -> Figure | None:
    """Sets that the paper's criterion lets pass, on the first knee."""
    return _sets(record, PAPER)


def figure_3(record: Row) -> Figure:
    """Ligament forces under the largest internal and external moments, on the first knee."""
    part = next(iter(record["knees"].values()))
    chosen = {name: case["chosen_forces"] for name, case in part["cases"].items()}
    shown = {_title(name): forces for name, forces in chosen.items() if "3.84" not in name}
    some = next(iter(shown.values()))
    return ik.report.ranges_figure(
        [name.replace(".tension_N@", ", ").replace("_", " ") for name in some],
        np.array([x["truth"] for x in some.values()]),
        {name: np.array([x["range"] for x in forces.values()]) for name, forces in shown.items()},
        unit="tension [N]",
    )


FIGURE_OF: Mapping[str, Callable[[Row], Figure | None]] = {
    "figure_1_noise": figure_1,
    "figure_2_paper": figure_2,
    "figure_3_forces": figure_3,
}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    return {
        "parameters": parameter_table(record),
        "sets": set_table(record),
        "table 6": force_table(record, "by_flexion_N", PAPER_TABLE6, "by flexion"),
        "table 7": force_table(record, "by_scenario_N", PAPER_TABLE7, "by load scenario"),
    }


def parameter_table(record: Row) -> ik.report.Table:
    """Smallest and largest value of every parameter, by knee and criterion."""
    setting = next(iter(record["knees"].values()))["setting"]
    names = setting["parameters"]
    truth: tuple[Cell, ...] = ("all", "truth", *(f"{x:g}" for x in setting["truth"]))
    body = [truth]
    for knee, part in record["knees"].items():
        for name, case in part["cases"].items():
            cells = [_range(case["parameters"][x]) for x in names]
            body.append((knee, _title(name), *cells))
    return ik.report.Table(
        title="Parameters of equivalent sets: smallest to largest value",
        columns=(
            ik.report.Column(name="knee"),
            ik.report.Column(name="equivalent up to"),
            *(ik.report.Column(name=_short(name), unit=_unit(name)) for name in names),
        ),
        rows=tuple(body),
    )


def set_table(record: Row) -> ik.report.Table:
    """How many sets, how different, what they cost, and how far kinematics differ at most."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for name, case in part["cases"].items():
            ends = case["ends"]
            body.append(
                (
                    knee,
                    _title(name),
                    case["n_sets"],
                    f"{case['diameter']:.3g}",
                    f"{case['farthest'] / case['diameter']:.3f}",
                    f"{case['closest'] / case['diameter']:.3f}",
                    *(f"{max(case['rmse'][x]):.2f}" for x in TITLES),
                    case["n_simulations"],
                    f"{ends.get('cliff', 0)} / {ends.get('budget', 0)} / {ends['found_once']}",
                )
            )
    return table(
        "The sets, and the largest kinematic error (RMSE at a flexion angle) of any",
        "knee; equivalent up to; sets; diameter [typical steps]; farthest pair [diameters]; "
        "closest pair [diameters]; drawer [mm]; varus [deg]; internal [deg]; simulations; "
        "forces: cliff / budget / found once",
        body,
    )


def force_table(record: Row, key: str, printed: Row, what: str) -> ik.report.Table:
    """The paper's differences of tension beside the largest possible ones."""
    body: list[tuple[Cell, ...]] = []
    for row, (label, paper) in enumerate(printed.items()):
        body.append((label, "the paper, IG4", "its one end", *(str(x[1]) for x in paper)))
        for knee, part in record["knees"].items():
            columns = [part["setting"]["ligaments"].index(x) for x in PAPER_LIGAMENTS]
            for name, case in part["cases"].items():
                values = case["forces"][key][row]
                body.append((label, knee, _title(name), *(_newton(values[j]) for j in columns)))
    return table(
        f"Largest difference of tension from the truth {what}",
        ["trials", "knee", "equivalent up to", *(f"{x} [N]" for x in PAPER_LIGAMENTS)],
        body,
    )


def _sets(record: Row, case: str) -> Figure | None:
    part = next(iter(record["knees"].values()))
    if case not in part["cases"]:
        return None
    found = part["cases"][case]
    return ik.report.sets_figure(
        part["setting"]["parameters"],
        np.array(found["sets"]),
        np.array(part["setting"]["truth"]),
        {title: np.array(found["bands"][name]) for name, title in TITLES.items()},
    )


def _range(of: Row) -> str:
    ends = [
        f"{value:.3g}{MARKS.get(end, '')}"
        for value, end in zip(of["range"], of["ends"], strict=True)
    ]
    return " to ".join(ends)


def _title(name: str) -> str:
    return "the paper's criterion" if name == PAPER else name.replace("D2", "D²")


def _newton(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if value < 10 else f"{value:.0f}"


def _short(name: str) -> str:
    owner, _, quantity = name.rpartition(".")
    return f"{owner} {'stiffness' if quantity.startswith('stiffness') else 'strain'}"


def _unit(name: str) -> str:
    return "kN" if name.endswith("_kN") else "%"


if __name__ == "__main__":
    main()
