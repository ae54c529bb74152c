"""An error of the model that is marginalised: who takes it, what it widens, what is said of it."""

import numpy as np
import pytest
from quick_calls import ALL_BUT_FOUR, quick, quick_verbs

import identknee as ik
from identknee.laxity.table import COORDINATES
from identknee.verbs.answer import IN_WORDS
from identknee.verbs.values import SMOOTH

SD = 0.3


@pytest.fixture(scope="module")
def bent() -> ik.Laxity:
    """Laxity of which one coordinate bends with flexion as no ligament makes it."""
    made = ik.simulate("reference", "drawer")
    shape = made.coordinates.shape
    coordinates = made.coordinates + np.random.default_rng(2).normal(0.0, SD, shape)
    coordinates[:, 0] += 1.5 * np.sin(made.protocol.flexion_deg / 20.0)
    return ik.Laxity(protocol=made.protocol, coordinates=coordinates, sd=np.full(shape, SD))


@pytest.mark.parametrize(
    "verb",
    quick_verbs(
        ("information", "profile", "equivalents", "sample"),
        slow=("equivalents", "sample", "information"),
    ),
)
def test_verbs_average_over_it_and_say_so(verb: str, bent: ik.Laxity) -> None:
    plain, found = (
        quick(verb, "reference", bent, fixed=ALL_BUT_FOUR, discrepancy=x)
        for x in ("none", "smooth")
    )
    assert plain.question is not None
    assert found.question is not None
    assert plain.question.discrepancy is None
    assert found.question.discrepancy == SMOOTH
    assert found.question.differences(plain.question) == (IN_WORDS["discrepancy"],)
    table = {x.evidence[0].name: x.evidence[0].deviance for x in (plain, found)}
    assert len(table) == 1
    assert found.evidence[0].deviance < 0.7 * plain.evidence[0].deviance
    assert "discrepancy" not in plain.uncertainty
    sizes = dict(x.rsplit(" ", 1) for x in found.uncertainty["discrepancy"].split(", "))
    assert max(sizes, key=lambda x: float(sizes[x])) == COORDINATES[0]


@pytest.mark.slow
def test_the_data_determine_less(bent: ik.Laxity) -> None:
    plain, found = (
        ik.information("reference", bent, fixed=ALL_BUT_FOUR, discrepancy=x)
        for x in ("none", "0.5mm,1deg")
    )
    assert np.all(found.fisher.eigenvalues < plain.fisher.eigenvalues)


def test_it_is_refused_without_a_noise(bent: ik.Laxity) -> None:
    unknown = ik.Laxity(protocol=bent.protocol, coordinates=bent.coordinates)
    with pytest.raises(ValueError, match="noise is stated"):
        ik.information("reference", unknown, fixed=ALL_BUT_FOUR, discrepancy="smooth")


@pytest.mark.parametrize("given", ["rough", "-1mm,1deg", "1mm"])
def test_what_is_no_size_is_refused(given: str, bent: ik.Laxity) -> None:
    with pytest.raises(ValueError, match=f"discrepancy {given}: "):
        ik.information("reference", bent, fixed=ALL_BUT_FOUR, discrepancy=given)
