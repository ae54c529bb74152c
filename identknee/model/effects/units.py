"""Units of parameters, which their names end with."""

# The first ending that fits counts.
UNITS = {
    "N_per_mm": "N/mm",
    "N_per_Nm": "N/N·m",
    "deg_per_Nm": "deg/N·m",
    "kN": "kN",
    "Nm": "N·m",
    "mm": "mm",
    "deg": "deg",
    "pct": "%",
    "N": "N",
}
PLAIN = "1"


def unit_of(parameter: str) -> str:
    """Unit of a parameter; ``"1"`` for a plain number.

    Examples
    --------
    >>> unit_of("rig_compliance_IE.compliance_deg_per_Nm"), unit_of("moment_gain_IE.gain")
    ('deg/N·m', '1')
    """
    last = parameter.rpartition(".")[2]
    return next((unit for end, unit in UNITS.items() if f"_{last}".endswith(f"_{end}")), PLAIN)
