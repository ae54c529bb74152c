"""Through how many modules a laxity table passes on its way to an answer.

`python tests/architecture/rooms.py [VERB ...]` counts every module of the package that runs between
the call of a verb and its answer, on the reference knee and 63 trials, and lists them.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import identknee as ik

ROOT = str(Path(ik.__file__).parent)
# Read, usable trials, question, engine, check, answer: more rooms than these are fragments.
MOST = {"fit": 45, "profile": 45, "diagnose": 70}


def rooms(call: Callable[[], Any]) -> set[str]:
    """Modules of the package that run while `call` does, without what is only imported."""
    seen: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        name = frame.f_code.co_filename
        if event != "call" or not name.startswith(ROOT) or name[len(ROOT) + 1 :] in seen:
            return
        # What runs while a module is imported, such as the body of a class, is no work on the data.
        back: FrameType | None = frame
        while back is not None and back.f_code.co_name != "<module>":
            back = back.f_back
        if back is None or not back.f_code.co_filename.startswith(ROOT):
            seen.add(name[len(ROOT) + 1 :])

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return seen


def main() -> int:
    """1 where a verb passes through more modules than it may."""
    knee = ik.reference_knee()
    data = ik.simulate(knee, noise="0.3mm,0.3deg").noisy
    is_more = False
    for name in sys.argv[1:] or list(MOST):
        found = rooms(lambda name=name: getattr(ik, name)(knee, data))  # type: ignore[misc]
        is_more |= len(found) > MOST[name]
        print(f"{name}: {len(found)} modules, at most {MOST[name]}")
        print("  " + " ".join(sorted(found)))
    return int(is_more)


if __name__ == "__main__":
    raise SystemExit(main())
