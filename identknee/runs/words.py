"""Names and numbers in words that need no manual."""

from collections.abc import Iterable, Sequence

MOTIONS = {"varus_deg": "varus angulation", "internal_deg": "internal rotation"}
# How people write the units that names end in. Longer endings stand before shorter ones.
UNITS = {
    "N_per_mm3": "N/mm3",
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
# The unit of a plain number, in results and tables.
PLAIN = "1"


def parameter_words(name: str) -> str:
    """A parameter or another quantity as the subject of a sentence.

    Examples
    --------
    >>> parameter_words("ACL.stiffness_kN")
    "the ACL's stiffness"
    >>> parameter_words("ACL.tension_N@flexion30_internal5")
    "the ACL's tension in trial flexion30_internal5"
    >>> parameter_words("varus_deg@a"), parameter_words("contact.medial_N@a")
    ('varus angulation in trial a', 'the medial contact force in trial a')
    """
    quantity, _, trial = name.partition("@")
    owner, _, kind = quantity.rpartition(".")
    words = coordinate_words(kind)
    whole = f"the {owner}'s {words}" if owner else words
    if contact := contact_words(quantity):
        whole = f"the {contact}"
    return f"{whole} in trial {trial}" if trial else whole


def contact_words(quantity: str) -> str:
    """A quantity of the contact or of a meniscus in words; empty for any other.

    Examples
    --------
    >>> contact_words("contact.medial_N"), contact_words("contact.lateral_x_mm")
    ('medial contact force', 'lateral contact centre x')
    >>> contact_words("meniscus.medial_N")
    'medial meniscus force'
    """
    owner, _, kind = quantity.partition(".")
    if owner not in ("contact", "meniscus") or "_per_" in kind:
        return ""
    side, *axis = kind.split("_")[:-1]
    return f"{side} {owner} centre {axis[0]}" if axis else f"{side} {owner} force"


def owner_words(name: str) -> str:
    """Whose quantity it is, where the quantity was named before; its words where it has no owner.

    Examples
    --------
    >>> owner_words("ACL.stiffness_kN"), owner_words("varus_deg")
    ("the ACL's", 'varus angulation')
    """
    quantity = name.partition("@")[0]
    owner = quantity.rpartition(".")[0]
    return f"the {owner}'s" if owner and not contact_words(quantity) else parameter_words(name)


def coordinate_words(name: str) -> str:
    """A coordinate, or any name that ends in its unit, in words.

    Examples
    --------
    >>> coordinate_words("internal_deg"), coordinate_words("anterior_drawer_mm")
    ('internal rotation', 'anterior drawer')
    >>> coordinate_words("medial_stiffness_N_per_mm3")
    'medial stiffness'
    """
    return MOTIONS.get(name) or _before_unit(name).replace("_", " ") or name


def label(name: str) -> str:
    """A parameter or coordinate with its unit in brackets, for a table.

    Examples
    --------
    >>> label("ACL.reference_strain_pct"), label("varus_deg"), label("x.total")
    ('ACL reference strain [%]', 'varus angulation [deg]', 'x total')
    >>> label("contact.medial_N@a"), label("meniscus.medial_N_per_mm")
    ('medial contact force [N] in a', 'meniscus medial [N/mm]')
    """
    quantity, at, trial = name.partition("@")
    words, unit = label_without_unit(quantity), unit_of(quantity)
    words = f"{words} [{unit}]" if unit else words
    return f"{words} in {trial}" if at else words


def listed_first(names: Sequence[str], most: int) -> str:
    """The first of some names as a list, and how many more there are.

    Examples
    --------
    >>> listed_first(["a", "b"], 2), listed_first(["a", "b", "c"], 2)
    ('a and b', 'a, b and 1 more')
    """
    more = len(names) - most
    return listed([*names[:most], *([f"{more} more"] if more > 0 else [])])


def unit_of(name: str) -> str:
    """The unit that a name ends in, as people write it; empty where it ends in none.

    Examples
    --------
    >>> unit_of("ACL.stiffness_kN"), unit_of("ACL.tension_N@a"), unit_of("x.value_pct")
    ('kN', 'N', '%')
    >>> unit_of("meniscal_wedge.medial_stiffness_N_per_mm3"), unit_of("moment_gain_IE.gain")
    ('N/mm3', '')
    """
    return UNITS.get(_ending(name.partition("@")[0]), "")


def _ending(quantity: str) -> str:
    """The end of a name that is its unit, empty where it has none."""
    last = quantity.rpartition(".")[2]
    return next((x for x in UNITS if f"_{last}".endswith(f"_{x}")), "")


def _before_unit(quantity: str) -> str:
    return quantity.removesuffix(_ending(quantity)).removesuffix("_")


def label_without_unit(name: str) -> str:
    """A parameter or force for a table whose cells have units.

    Examples
    --------
    >>> label_without_unit("ACL.reference_strain_pct"), label_without_unit("ACL.tension_N@a")
    ('ACL reference strain', 'ACL tension in a')
    >>> label_without_unit("meniscal_wedge.medial_stiffness_N_per_mm3")
    'meniscal wedge medial stiffness'
    """
    quantity, at, trial = name.partition("@")
    plain = _before_unit(quantity).replace(".", " ").replace("_", " ")
    words = contact_words(quantity) or MOTIONS.get(quantity) or plain
    return f"{words} in {trial}" if at else words


def amount(value: float | None, unit: str, digits: int = 3) -> str:
    """A number with its unit.

    Examples
    --------
    >>> amount(0.7766, "kN"), amount(0.08, "1"), amount(None, "kN"), amount(1234.5, "N")
    ('0.777 kN', '0.08', 'unknown', '1230 N')
    """
    if value is None:
        return "unknown"
    number = f"{float(f'{value:.{digits}g}'):.10g}".replace("-", "−")
    return number if unit in ("1", "") else f"{number} {unit}"


def two_values_words(name: str, value: float, other: float) -> str:
    """Two values of a parameter that two searches found.

    Examples
    --------
    >>> two_values_words("ACL.stiffness_kN", 9.96, 11.36)
    'ACL stiffness 9.96 or 11.4 kN'
    """
    return f"{label_without_unit(name)} {amount(value, '')} or {amount(other, unit_of(name))}"


def error_words(name: str) -> str:
    """A stated error in words, without its article.

    Examples
    --------
    >>> error_words("insertion.ACL_femur"), error_words("registration.tibia")
    ('ACL insertion on the femur', 'registration of the tibia')
    """
    kind, _, place = name.partition(".")
    words = kind.replace("_", " ")
    if not place:
        return words
    ligament, _, bone = place.rpartition("_")
    return f"{ligament} {words} on the {bone}" if ligament else f"{words} of the {bone}"


def listed(words: Iterable[str], last: str = "and") -> str:
    """Words as in a sentence.

    Examples
    --------
    >>> listed(["a", "b", "c"]), listed(["a", "b"], "or")
    ('a, b and c', 'a or b')
    """
    *most, end = [*words] or [""]
    return f"{', '.join(most)} {last} {end}" if most else end


def capitalised(sentence: str) -> str:
    """The sentence with a capital letter, the rest as it is."""
    return sentence[:1].upper() + sentence[1:]


def between(ends: tuple[float | None, float | None], unit: str) -> str:
    """A range as in a sentence, open ends included.

    Examples
    --------
    >>> between((1.0, 2.5), "kN"), between((1.0, None), "kN"), between((None, 2.5), "kN")
    ('from 1 to 2.5 kN', 'from 1 kN upwards', 'up to 2.5 kN')
    """
    return interval(ends, unit) if ends[0] is None else f"from {interval(ends, unit)}"


def interval(ends: tuple[float | None, float | None], unit: str) -> str:
    """A range as in a table, open ends included.

    Examples
    --------
    >>> interval((1.0, 2.5), "kN"), interval((1.0, None), "kN"), interval((None, 2.5), "kN")
    ('1 to 2.5 kN', '1 kN upwards', 'up to 2.5 kN')
    """
    low, high = ends
    if low is not None and high is not None:
        return f"{amount(low, '')} to {amount(high, unit)}"
    if low is not None:
        return f"{amount(low, unit)} upwards"
    return "any value" if high is None else f"up to {amount(high, unit)}"
