"""What an answer takes for granted: the trials that it rests on, and its assumptions."""

from identknee.runs.words import listed
from identknee.verbs.answer import Answer

# So many trials are listed by name.
MOST_NAMED = 8


def taken_for_granted(answer: Answer) -> tuple[str, ...]:
    """The assumptions of an answer, as sentences."""
    trials = answer.trials_used
    if not trials:
        return answer.assumptions
    names = f": {listed(trials)}" if len(trials) <= MOST_NAMED else ""
    many = "1 measured trial" if len(trials) == 1 else f"{len(trials)} measured trials"
    return (f"The result rests on {many}{names}.", *answer.assumptions)
