"""Parameters as the table that PEtab has for them, with what was found beside it."""

import csv
import io
import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from identknee.model.parameters import Parameters
from identknee.report.range import Range

COLUMNS = (
    *("parameterId", "parameterName", "parameterScale", "lowerBound", "upperBound"),
    *("nominalValue", "estimate", "objectivePriorType", "objectivePriorParameters"),
    *("fittedValue", "lower95", "upper95", "evidence"),
)


def parameter_table(
    parameters: Parameters,
    fitted: Mapping[str, float],
    ranges: Mapping[str, Sequence[Range]],
    *,
    fixed: Collection[str] = (),
) -> str:
    """The table as tab-separated text, a row a parameter.

    The first nine columns are those of PEtab. ``nominalValue`` is the subject's own value. The
    others are the value found and its 95 % set by the method named under ``evidence``; an open end
    and what is not known are blank. All scales are linear, since a stiffness may be zero; units end
    the names.

    Parameters
    ----------
    parameters
        The model's parameters.
    fitted
        Values found, by name.
    ranges
        By name what each method says of it, the most telling first.
    fixed
        Names of those that were not estimated.
    """
    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    writer.writerow(COLUMNS)
    for i, name in enumerate(parameters.names):
        found = next(iter(ranges.get(name, ())), None)
        center, sd = float(parameters.center[i]), float(parameters.prior_sd[i])
        is_log = bool(parameters.is_log[i])
        writer.writerow(
            [
                *(re.sub(r"\W", "_", name), name, "lin"),
                *(float(parameters.lower[i]), float(parameters.upper[i])),
                *(float(parameters.start[i]), int(name not in fixed)),
                *(
                    "logNormal" if is_log else "normal",
                    f"{np.log(center) if is_log else center};{sd}",
                ),
                *(fitted.get(name, ""), *_set_of(found)),
            ]
        )
    return text.getvalue()


def _set_of(found: Range | None) -> tuple[float | str, float | str, str]:
    """Both ends of a set and the method that gave it."""
    if found is None:
        return "", "", ""
    low, high = ("" if x is None else float(x) for x in (found.low, found.high))
    return low, high, found.source.value
