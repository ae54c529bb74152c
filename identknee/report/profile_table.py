"""The sets of likely values as lines of text."""

from collections.abc import Sequence

from identknee.identify.profile.result import Profile


def profile_table(profiles: Sequence[Profile]) -> list[str]:
    """A line for each profile under a head: lower end, best value, upper end, verdict."""
    width = max(len(profile.name) for profile in profiles)
    return [
        f"{'':{width}}  {'lower':>9}  {'best':>9}  {'upper':>9}  verdict",
        *(
            f"{profile.name:{width}}  {_end(profile.lower):>9}  {profile.optimum_value:9.4f}  "
            f"{_end(profile.upper):>9}  {profile.verdict.value}"
            for profile in profiles
        ),
    ]


def shown_parts(profile: Profile) -> str:
    """The parts of a set that is not one interval, in words."""
    return " and ".join(f"{_end(low)} to {_end(high)}" for low, high in profile.intervals)


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.4f}"
