"""What the Fisher information says: which combinations of parameters are known, and how well."""

from collections.abc import Iterator

from identknee.identify.information.information import Information
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import label, listed, parameter_words
from identknee.verbs.information import LocalIdentifiability


def information_statements(answer: LocalIdentifiability) -> Iterator[Statement]:
    """Whether data could determine every parameter, how well these do, and what they leave."""
    found, structure = answer.fisher, answer.structure
    n = len(found.parameter_names)
    alike = ""
    if n > 1:
        pair = found.most_collinear[0]
        words = listed(map(parameter_words, pair.parameters))
        alike = f" Hardest to tell apart are {words} (collinearity {pair.collinearity:.3g})."
    yield _known(
        f"{structure.sentence} The sensitivities have rank {max(structure.rank, 0)} of {n} "
        f"({structure.n_points} random points, {structure.n_with_prediction} with a prediction)."
        f"{alike}"
    )
    yield _known(
        f"{found.n_above_noise} of {n} combinations of parameters stand above numerical noise "
        f"(condition number {found.condition:.3g}).",
        Table(
            title="Combinations of parameters, from well to badly known",
            columns=(
                Column(name="combination, in scaled units"),
                Column(name="eigenvalue", decimals=None),
                Column(name="noise floor", decimals=None),
            ),
            rows=tuple((x.combination, x.value, x.floor) for x in found.spectrum),
        ),
    )
    yield _known(
        "These standard deviations take the model as linear near the best fit; profiles do not.",
        _parameters(found),
    )
    for path in answer.geodesics:
        involved = listed(map(parameter_words, path.involved))
        yield _known(
            f"Path along the least known combination, which is about {involved}: "
            f"{path.boundary.sentence}"
        )


def _known(sentence: str, *tables: Table) -> Statement:
    return Statement(question=Question.KNOWN, sentence=sentence, tables=tables)


def _parameters(found: Information) -> Table:
    return Table(
        title="Parameters around the best fit",
        columns=(
            Column(name="parameter"),
            Column(name="best", decimals=None),
            Column(name="sd", decimals=None),
        ),
        rows=tuple(
            (label(name), float(best), float(sd))
            for name, best, sd in zip(found.parameter_names, found.theta, found.sd, strict=True)
        ),
    )
