"""The figure of what no knee does: where its marks stand."""

import numpy as np
import pytest

from identknee.checks.limit_price import LimitPrice, PlausibilityPrice
from identknee.model.limit_residuals import LimitAtFit
from identknee.report.laxity_figures import MOST, plausibility_figure


def _price(name: str, form: str, value: float, size: float, without: float) -> LimitPrice:
    limit = LimitAtFit(
        name=name, form=form, value=value, size=size, spread=0.2 * size, deviance=1.0, source=""
    )
    return LimitPrice(limit=limit, drop_one=1.0, value_without=without, alone=1.0)


def test_marks_are_shares_of_the_limits() -> None:
    rows = (
        _price("ACL.tension_N", "strength", 500.0, 1000.0, 6000.0),
        _price("MCL.strain_pct", "strength", -4.0, 15.0, 30.0),
        _price("contact.medial_N - contact.lateral_N", "within", -300.0, 150.0, 225.0),
    )
    price = PlausibilityPrice(limits=rows, price=3.0, of_data=1.0, without={})
    axes = plausibility_figure(price).axes[0]
    drawn = {str(x.get_label()): np.asarray(x.get_xdata(), float) for x in axes.lines}
    assert drawn["fit with limits"] == pytest.approx([0.5, 0.0, 2.0])
    assert drawn["fit without limits"] == pytest.approx([MOST, 2.0, 1.5])
    assert [x.get_text() for x in axes.texts] == ["6000"]
    assert len(axes.get_yticklabels()) == len(rows)
