"""Experiments on one knee: its state, the rig that loads it, and how it is mounted there."""

import re
from collections.abc import Mapping, Sequence

from identknee.runs.declare import declared, entry
from identknee.runs.errors import ValueRefused

INTACT, CUT = "intact", "cut:"
# Constant error of the forces and of the moments of a rig's load cell [N, N m].
LOAD_CELL = ("load_cell_N", "load_cell_Nm")
LARGEST_OFFSET = (1000.0, 100.0)
_LIGAMENT = re.compile(r"(?P<ligament>[^,%]+?)(?:\s+(?P<percent>[0-9.]+)\s*%)?")
_BETWEEN = re.compile(r"\s*[,+&/;]\s*|\s+and\s+")
_NAME = re.compile(r"[\w-]([\w -]*[\w-])?")
_STATE = re.compile(
    r"(cut\s*:|(cut|without)\s)(?P<first>.+)"
    r"|(?P<last>.+?)[\s_-]+(cut|deficient|sectioned|transected|resected|removed)",
    re.IGNORECASE,
)
_INTACT = re.compile(r"((intact|native)([\s_-]+knee)?)?", re.IGNORECASE)
WRITE = 'write "intact", "cut: ACL", "cut: ACL, dMCL" or "cut: ACL 50%"'


@declared
class Cut:
    """A ligament, a bundle or a group that was cut."""

    ligament: str = entry("Its name")
    fraction: float = entry("Fraction of its stiffness that is gone, 1 if cut through", unit="1")

    @property
    def words(self) -> str:
        """It in words, such as ``"ACL"`` or ``"ACL 50%"``."""
        share = f" {100.0 * self.fraction:g}%" if self.is_partial else ""
        return f"{self.ligament}{share}"

    @property
    def is_partial(self) -> bool:
        """Whether part of it still carries load."""
        return self.fraction < 1.0


@declared
class Experiment:
    """One table of laxity tests on a knee: who made it, and how the knee was mounted."""

    name: str = entry("Name of the experiment")
    rig: str = entry("The rig: experiments of one rig share its frames, load axes and gains")
    mounting: str = entry(
        "The mounting: experiments of one mounting share zeros and offset of flexion"
    )
    uncertainty: Mapping[str, float] = entry(
        "What the rig states to be uncertain, by part of `identknee.subject.knee.Uncertainty`; the "
        "subject's sizes hold for the others. Also the constant error of its load cell, "
        "`load_cell_N` and `load_cell_Nm`",
        default_factory=dict,
    )
    side: str = entry("Side of the knee, left or right; empty where it is not stated", default="")

    def __post_init__(self) -> None:
        if self.side not in ("", "left", "right"):
            raise ValueRefused(f"the side {self.side!r} is unknown", "write left or right")
        for kind in ("name", "rig", "mounting"):
            if not _NAME.fullmatch(name := getattr(self, kind)):
                raise ValueRefused(
                    f"{name!r} is not a name for an experiment, a rig or a mounting",
                    "use letters, digits, -, _ and spaces",
                )
        for part, most in zip(LOAD_CELL, LARGEST_OFFSET, strict=True):
            if not 0.0 <= (value := self.uncertainty.get(part, 0.0)) <= most:
                raise ValueRefused(
                    f"the uncertainty {part} of the rig {self.rig} is {value:g}",
                    f"give a standard deviation of 0 to {most:g}",
                )


def cuts_of(state: str) -> tuple[Cut, ...]:
    """What was cut in a state such as ``"cut: ACL, MCL 50%"``; nothing where the knee is intact.

    Raises
    ------
    ValueError
        If the state has another form, names a ligament twice, or a percentage is not above 0 and
        at most 100.

    Examples
    --------
    >>> [(x.ligament, x.fraction) for x in cuts_of("cut: ACL, MCL 50%")]
    [('ACL', 1.0), ('MCL', 0.5)]
    >>> cuts_of("intact"), state_words(cuts_of("ACL cut")), state_words(cuts_of("ACL-deficient"))
    ((), 'cut: ACL', 'cut: ACL')
    >>> state_words(cuts_of("ACL+MCL cut")), state_words(cuts_of("cut: LCL and ACL"))
    ('cut: ACL, MCL', 'cut: ACL, LCL')
    """
    if _INTACT.fullmatch(state.strip()):
        return ()
    if (form := _STATE.fullmatch(state.strip())) is None:
        raise ValueRefused(f"the state {state!r} is unknown", WRITE)
    found = [_cut(state, x) for x in _BETWEEN.split(form["first"] or form["last"])]
    names = [x.ligament for x in found]
    if twice := next((x for x in names if names.count(x) > 1), ""):
        raise ValueRefused(f"the state {state!r} cuts {twice} twice", "name each ligament once")
    return tuple(found)


def _cut(state: str, words: str) -> Cut:
    match = _LIGAMENT.fullmatch(words.strip())
    if match is None:
        raise ValueRefused(f"the state {state!r} names no ligament", WRITE)
    try:
        fraction = float(match["percent"] or 100.0) / 100.0
    except ValueError:
        fraction = 0.0
    if not 0.0 < fraction <= 1.0:
        raise ValueRefused(
            f"the state {state!r} cuts {match['percent']} % of {match['ligament']}",
            "give a percentage above 0 and at most 100",
        )
    return Cut(ligament=match["ligament"], fraction=fraction)


def state_words(cuts: Sequence[Cut]) -> str:
    """The state in one form: ligaments in order of their names.

    Examples
    --------
    >>> state_words(cuts_of("Cut:  MCL 50 %,ACL"))
    'cut: ACL, MCL 50%'
    >>> state_words(())
    'intact'
    """
    if not cuts:
        return INTACT
    return f"{CUT} {', '.join(x.words for x in sorted(cuts, key=lambda x: x.ligament))}"
