"""Limits of plausibility: of force, strain and contact, which count as evidence where asked for.

A limit is about a specimen, not about a trial: it has one residual for all trials of a knee. There
are three forms. A *strength* says that the specimen did not fail: with strengths that are normal
over specimens, its deviance is ``-2 log Phi((mean - largest) / sd)``. *Within* is a half-normal
beyond a number, for the mean over trials. *Normal* is a value published for a standard load.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import numpy as np
from pydantic import Field, StringConstraints, model_validator

from identknee.runs.errors import InputError, ValueRefused
from identknee.runs.files import PathLike
from identknee.runs.schema import (
    Fault,
    Number,
    Part,
    Place,
    custom_message,
    read_toml,
    refusal,
    remedy_of,
    validated,
)

Form = Literal["strength", "within", "normal"]
Trials = Literal["all", "no varus moment", "nearly unloaded"]
TENSION, STRAIN, CONTACT = "tension_N", "strain_pct", "contact"
AT, KEY = "@", "plausibility"
DEFAULT, NONE = "default", "none"

# Mean failure load of each ligament and its standard deviation over specimens [N]. Ligaments whose
# names begin with a key are bundles of it. Where a source states the mean alone, the deviation is
# 30 % of it, as that of the anterolateral bundle of the PCL is (500 of 1620 N).
ASSUMED_SHARE = 0.3
WOO = "Woo 1991, doi:10.1177/036354659101900303"
RACE = "both bundles, Race 1994, doi:10.1016/0021-9290(94)90028-0"
LAPRADE = "LaPrade 2005, doi:10.1177/0363546504274143"
WIJDICKS = "Wijdicks 2010, doi:10.1177/0363546510363465"
STRENGTHS: Mapping[str, tuple[float, float, str]] = {
    "PCL": (1878.0, 507.0, RACE),
    "LCL": (295.0, ASSUMED_SHARE * 295.0, LAPRADE),
    "PFL": (298.0, ASSUMED_SHARE * 298.0, LAPRADE),
    "MCL": (557.0, ASSUMED_SHARE * 557.0, WIJDICKS),
    "sMCL": (557.0, ASSUMED_SHARE * 557.0, WIJDICKS),
    "dMCL": (101.0, ASSUMED_SHARE * 101.0, WIJDICKS),
    "POL": (256.0, ASSUMED_SHARE * 256.0, WIJDICKS),
}
# Structures that a model may have beside the ligaments of the subject, by their names in the
# library of causes, and how the names of ligaments begin that are the same structure.
OTHER_NAMES: Mapping[str, tuple[str, ...]] = {
    "anterolateral": ("ALL", "ALS"),
    "posteromedial": ("POL",),
    "popliteofibular": ("PFL",),
    "deep_mcl": ("dMCL",),
    "posterior_capsule": ("PCAP",),
}
# The ACL by age of the donor: up to so many years, mean and standard deviation [N].
ACL, YOUNG = "ACL", (2160.0, 157.0)
ACL_BY_AGE = ((37.0, *YOUNG), (55.0, 1503.0, 83.0), (np.inf, 658.0, 129.0))
# Of an unknown age: mean and deviation of the three groups together.
ACL_OF_ANY_AGE = (1440.0, 628.0)
# Ligament tissue fails at about this strain [%]. The deviation is an assumption.
FAILURE_PCT, FAILURE_SD_PCT = 15.0, 2.0
BUTLER = "Butler 1986, doi:10.1016/0021-9290(86)90019-9"
# Largest mean difference of both contact forces without varus moment, and its scale [N]. An
# assumption: the published 67 N are of arthroplasties balanced with sensors.
BALANCE_N, BALANCE_SCALE_N = 150.0, 50.0
GUSTKE = (
    "an assumption; arthroplasties are balanced to 67 N, Gustke 2014, "
    "doi:10.1016/j.arth.2013.10.020"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """A limit of plausibility.

    Attributes
    ----------
    form
        ``"strength"`` for the largest value over trials, which stays below a normal strength;
        ``"within"`` for the mean over trials, half-normal beyond a size; ``"normal"`` for the value
        under a standard load.
    quantity
        What is limited: ``"MCL.tension_N"``, ``"ACL.strain_pct"`` or ``"contact.medial_N"``, for a
        normal value with its load, as in ``"ACL.tension_N@134 N anterior force, 30 deg"``.
        Ligaments whose names begin with the first word count together.
    size, spread
        Mean and standard deviation of a strength or a normal value; size beyond which the
        half-normal begins, and its scale [N or %].
    less
        A second contact force that is taken from the first; none if empty.
    trials
        Which trials count: ``"all"``, ``"no varus moment"`` or ``"nearly unloaded"``.
    source
        Where the numbers are from.

    Raises
    ------
    ValueError
        If a number is not positive, or a name is not one of those above.
    """

    form: Form
    quantity: str
    size: float
    spread: float
    less: str = ""
    trials: Trials = "all"
    source: str = ""
    load: str = field(init=False, default="")

    def __post_init__(self) -> None:
        what, at, load = self.quantity.partition(AT)
        object.__setattr__(self, "load", load.strip())
        for name, value, known in (
            ("form", self.form, get_args(Form)),
            ("trials", self.trials, get_args(Trials)),
        ):
            if value not in known:
                raise ValueRefused(
                    f"{name} {value!r} is not known", f"write one of {', '.join(known)}"
                )
        if not (np.isfinite([self.size, self.spread]).all() and self.spread > 0.0 < self.size):
            raise ValueRefused(
                f"a limit of {self.quantity} needs two positive numbers, got {self.size:g} and "
                f"{self.spread:g}",
                "state them in N or %",
            )
        for one in (what, *([self.less] if self.less else [])):
            kind = one.rpartition(".")[2]
            if kind not in (TENSION, STRAIN) and one not in (
                f"{CONTACT}.medial_N",
                f"{CONTACT}.lateral_N",
            ):
                raise ValueRefused(
                    f"{one!r} has no limit",
                    f"write NAME.{TENSION}, NAME.{STRAIN}, {CONTACT}.medial_N or "
                    f"{CONTACT}.lateral_N",
                )
        if self.less and not (what.startswith(CONTACT) and self.less.startswith(CONTACT)):
            raise ValueRefused(
                f"a limit of {what} less {self.less} is not known",
                "limit each alone; only contact forces have a difference",
            )
        if bool(at) != (self.form == "normal"):
            raise ValueRefused(
                f"the {self.form} of {self.quantity} is "
                + ("of all trials" if at else "under a standard load"),
                "leave out what follows @"
                if at
                else f'name the load, as in "{what}{AT}134 N anterior force, 30 deg"',
            )

    @property
    def what(self) -> str:
        """What is limited, without its load."""
        return self.quantity.partition(AT)[0]

    @property
    def owner(self) -> str:
        """Ligament, group or structure that is limited, or ``"contact"``."""
        return self.what.rpartition(".")[0]

    @property
    def unit(self) -> str:
        """Unit of its numbers."""
        return "%" if self.what.endswith(STRAIN) else "N"

    @property
    def name(self) -> str:
        """Its name: what is limited and where, such as ``"MCL.tension_N"``."""
        which = "" if self.trials == "all" else f", {self.trials}"
        return f"{self.quantity}{f' - {self.less}' if self.less else ''}{which}"


Limits = tuple[Limit, ...]


LIMITS_COUNT = (
    "Limits of what a knee does count as evidence beside the data. To leave out: --plausible none."
)


def limit_sentences(limits: Limits) -> tuple[str, ...]:
    """That limits count, as a sentence for the user; none without limits."""
    return (LIMITS_COUNT,) if limits else ()


PlausibleLike = str | Path | Sequence[Limit] | None


def default_limits(ligaments: Sequence[str], donor_age: float | None = None) -> Limits:
    """Limits for a knee with ligaments of these names: strengths, strains, balance of contact.

    The strengths include those of structures that a model may have beside the ligaments, as a cause
    that explains the data. They count where it has them.

    Parameters
    ----------
    ligaments
        Their names.
    donor_age
        Age of the donor [years], on which the strength of the ACL depends; None if unknown.

    Examples
    --------
    >>> [x.name for x in default_limits(["MCL"])][::4]
    ['MCL.tension_N', 'MCL.strain_pct']
    """
    return tuple(_default_limits(ligaments, donor_age))


def _default_limits(ligaments: Sequence[str], donor_age: float | None) -> Iterator[Limit]:
    strengths = strengths_by_name(donor_age)
    for name, (mean, sd, source) in strengths.items():
        others = OTHER_NAMES.get(name)
        # A structure beside the ligaments may be added to any model whose ligaments lack it.
        if any(x.startswith(others or name) for x in ligaments) == (others is None):
            yield Limit(
                form="strength",
                quantity=f"{name}.{TENSION}",
                size=mean,
                spread=sd,
                source=source,
            )
    named = [next((k for k in strengths if x.startswith(k)), x) for x in ligaments]
    for name in dict.fromkeys(named):
        yield Limit(
            form="strength",
            quantity=f"{name}.{STRAIN}",
            size=FAILURE_PCT,
            spread=FAILURE_SD_PCT,
            source=BUTLER,
        )
    for trials in ("no varus moment", "nearly unloaded"):
        yield Limit(
            form="within",
            quantity=f"{CONTACT}.medial_N",
            less=f"{CONTACT}.lateral_N",
            size=BALANCE_N,
            spread=BALANCE_SCALE_N,
            trials=trials,
            source=GUSTKE,
        )


def strengths_by_name(donor_age: float | None = None) -> dict[str, tuple[float, float, str]]:
    """Mean strength [N], standard deviation and source, by how the names of ligaments begin.

    Structures of the library have those of ligaments with their other names.
    """
    known = {ACL: (*acl_strength(donor_age), WOO), **STRENGTHS}
    structures = {
        name: known[x] for name, others in OTHER_NAMES.items() for x in others if x in known
    }
    return {**known, **structures}


def acl_strength(donor_age: float | None) -> tuple[float, float]:
    """Mean strength of the ACL and its standard deviation [N], by age of the donor [years].

    Measured at 22 to 35, 40 to 50 and 60 to 97 years [1]_; between them the nearer group counts. Of
    an unknown age it is that of all three together.

    References
    ----------
    .. [1] Woo et al. (1991), Am J Sports Med 19:217-225, doi:10.1177/036354659101900303.
    """
    if donor_age is None:
        return ACL_OF_ANY_AGE
    return next((mean, sd) for most, mean, sd in ACL_BY_AGE if donor_age <= most)


Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


class NormalTable(Part):
    """``{ mean = 557.0, sd = 160.0 }``."""

    mean: Number
    sd: Number


class LimitTable(Part):
    """A ``[[plausibility]]``."""

    quantity: Text | None = None
    difference_of: Annotated[list[Text], Field(min_length=2, max_length=2)] | None = None
    strength: NormalTable | None = None
    normal: NormalTable | None = None
    within: Number | None = None
    scale: Number | None = None
    trials: Text = "all"
    source: Text = "the user"

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if (self.quantity is None) == (self.difference_of is None):
            raise refusal(
                "a limit has a quantity or a difference_of",
                'Write quantity = "MCL.tension_N", or difference_of with two.',
            )
        given = [self.strength, self.normal, self.within]
        if sum(x is not None for x in given) != 1 or (self.within is None) != (self.scale is None):
            raise refusal(
                "a limit has one of strength, normal, or within and scale",
                "Write strength = { mean = 557.0, sd = 160.0 }, or within = 150.0, scale = 150.0.",
            )
        return self

    def limit(self) -> Limit:
        """The limit.

        Raises
        ------
        ValueError
            As `Limit`.
        """
        quantity, less = self.difference_of or (self.quantity or "", "")
        form: Form = "strength" if self.strength else "normal" if self.normal else "within"
        stated = self.strength or self.normal
        size, spread = (
            (self.within or 0.0, self.scale or 0.0) if stated is None else (stated.mean, stated.sd)
        )
        return Limit(
            form=form,
            quantity=quantity,
            less=less,
            size=size,
            spread=spread,
            trials=self.trials,  # type: ignore[arg-type]
            source=self.source,
        )


LIMITS = custom_message("a list of tables is wanted", f"Write each below a line [[{KEY}]].")
LIMIT_EXAMPLES = {
    "mean": "mean = 557.0",
    "sd": "sd = 160.0",
    "quantity": 'quantity = "MCL.tension_N"',
    "within": "within = 150.0",
    "scale": "scale = 150.0",
    KEY: f'[[{KEY}]] with quantity = "MCL.tension_N"',
}


class LimitsFile(Part):
    """A file of limits."""

    plausibility: Annotated[list[Annotated[LimitTable, LIMITS]], LIMITS]


def read_limits(path: PathLike) -> Limits:
    """The limits of a file with ``[[plausibility]]`` tables.

    Raises
    ------
    InputError
        If it cannot be read, or breaks the schema: it names the place and the remedy.
    """
    file = Path(path)

    def refuse(fault: Fault) -> InputError:
        remedy = remedy_of(LimitsFile, fault, LIMIT_EXAMPLES)
        return InputError(file, _place(fault.place), fault.why, remedy)

    tables = validated(LimitsFile, read_toml(file), refuse).plausibility
    made = []
    for i, table in enumerate(tables):
        try:
            made.append(table.limit())
        except ValueRefused as error:
            raise InputError(file, _place((KEY, i)), error.why, error.advice) from error
    return tuple(made)


def _place(place: Place) -> str:
    words = [str(x) for x in place if isinstance(x, str)]
    number = next((x for x in place if isinstance(x, int)), None)
    if words and number is not None:
        words[0] = f"[[{words[0]}]] block {number + 1}"
    return ", ".join(words)


def plausible_limits(asked: str | Path | Sequence[Limit], default: Limits) -> Limits:
    """The limits asked for.

    Parameters
    ----------
    asked
        ``"default"`` or ``"none"``, a file, or the limits themselves.
    default
        The limits of a subject that ``"default"`` stands for.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if asked == NONE:
        return ()
    if asked == DEFAULT:
        return default
    if isinstance(asked, str | Path):
        if Path(asked).suffix != ".toml":
            raise ValueRefused(
                f"--plausible {str(asked)!r} is not a file of limits",
                f"write {DEFAULT}, {NONE}, or a file that ends in .toml",
            )
        return read_limits(asked)
    limits = tuple(asked)
    if not all(isinstance(x, Limit) for x in limits):
        kind = next(type(x).__name__ for x in limits if type(x) is not Limit)
        raise ValueRefused(
            f"plausible has a {kind} in it",
            "give default, none, a file, or a list of Limit",
        )
    return limits
