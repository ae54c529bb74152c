"""How long work will still take, from how far it is."""

# Less of the work says too little of the rest.
LEAST_SHARE = 0.02


def time_left(elapsed_s: float, share: float, before: float = 0.0) -> float | None:
    """Seconds until all is done, at the speed so far; None while that is not known.

    Parameters
    ----------
    elapsed_s
        Time since the work began, or was resumed.
    share
        Share of the work that is done.
    before
        Share that was done when it began.

    Examples
    --------
    >>> time_left(30.0, 0.25)
    90.0
    >>> time_left(30.0, 0.75, before=0.5)
    30.0
    """
    if share - before < LEAST_SHARE:
        return None
    return elapsed_s * max(1.0 - share, 0.0) / (share - before)


def in_words(seconds: float | None) -> str:
    """Time left as a person says it.

    Examples
    --------
    >>> [in_words(x) for x in (None, 4.0, 87.0, 150.0, 4000.0)]
    ['', 'about 4 s left', 'about 90 s left', 'about 2 min left', 'about 1.1 h left']
    """
    if seconds is None:
        return ""
    if seconds < 120.0:
        rounded = round(seconds, -1) if seconds > 60.0 else round(max(seconds, 1.0))
        return f"about {rounded:.0f} s left"
    if seconds < 3600.0:
        return f"about {seconds / 60.0:.0f} min left"
    return f"about {seconds / 3600.0:.1f} h left"
