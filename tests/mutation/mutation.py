"""A fault put into the package by hand, and the tests that must go red with it."""

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """A fault.

    Attributes
    ----------
    file
        Of the package, from the root of the repository.
    old, new
        Text that occurs once in the file, and what takes its place.
    why
        What a user would get from it.
    tests
        Tests of which at least one must fail, as pytest takes them.
    """

    file: str
    old: str
    new: str
    why: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """What tells it from others."""
        return f"{self.file}: {self.old.strip()} -> {self.new.strip() or 'nothing'}"

    def applied(self, text: str) -> str:
        """The text of the file with the fault.

        Raises
        ------
        ValueError
            If the place is not there, or there more than once.
        """
        if text.count(self.old) != 1:
            raise ValueError(
                f"{self.file} holds {self.old!r} {text.count(self.old)} times; a mutation needs "
                "one place"
            )
        return text.replace(self.old, self.new)
