"""Options, hypothesis profiles and the knees that many tests share."""

import gc
import os
import subprocess
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

# Read when numpy is loaded; test processes with threads of their own get in each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from few_starts import use_few_starts
from golden_texts import Golden, kept_text
from hypothesis import HealthCheck, settings
from small_knee import small_knee, small_protocol

from identknee.laxity.protocol import load_protocol
from identknee.model import laxity_model
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.subject.folder import example
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee

# The same examples every time, and none kept on disk: what passes here passes elsewhere.
settings.register_profile(
    "ci",
    max_examples=12,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "deep", max_examples=500, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)

# Where whole verbs run to see what they make of their fits, not whether these are the lowest.
UNIT = Path(__file__).parent / "unit"
FEW_STARTS = {
    UNIT / x
    for x in ("cli", "laxity", "model", "model/nuisances", "report", "runs", "subject", "verbs")
}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow tests too")
    parser.addoption("--golden", action="store_true", help="write the golden texts anew")


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("deep" if config.getoption("--slow") else "ci")
    # A failing example names its arguments, whole models among them.
    config.addinivalue_line("filterwarnings", "ignore:Generating overly large repr")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--slow"):
        return
    skip = pytest.mark.skip(reason="slow; run with --slow")
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(skip)


# Whatever calls the compiled functions.
FIRST_CALLS = """
import identknee as ik
from identknee.blind.case import blind_case
knee, protocol = ik.reference_knee(), ik.load_protocol("drawer")
ik.simulate(knee, protocol)
blind_case(knee, seed=1, effect=None, protocol=protocol)
"""
_compiling: list[subprocess.Popen[bytes]] = []


def pytest_sessionstart(session: pytest.Session) -> None:
    # Beside the collection: test processes would wait for one of them that compiles.
    config = session.config
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        _compiling.append(subprocess.Popen([sys.executable, "-c", FIRST_CALLS]))


def pytest_sessionfinish() -> None:
    for process in _compiling:
        process.kill()
        process.wait()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path,
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    # Where there are no examples, looking for some takes as long as the import.
    found = yield
    if file_path.suffix == ".py" and ">>>" not in file_path.read_text("utf-8"):
        return [x for x in found if type(x) is pytest.Module]
    return found


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    # Modules and thousands of tests stay to the end: rubbish is not looked for among them.
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """Called with a name and a text, which must be the one kept; ``--golden`` keeps it anew."""

    def compare(name: str, text: str) -> None:
        assert f"{text}\n" == kept_text(name, text if request.config.getoption("--golden") else "")

    return compare


@pytest.fixture(scope="session")
def reference() -> Knee:
    """The reference knee at its default resolution."""
    return reference_knee()


@pytest.fixture(scope="session")
def reference_model(reference: Knee) -> LaxityModel:
    """The reference knee under the 63 trials."""
    return LaxityModel(knee=reference, protocol=load_protocol("seed63"))


@pytest.fixture(scope="session")
def reference_prediction(reference_model: LaxityModel) -> Prediction:
    """Its prediction at the subject's own parameters, with derivatives."""
    return reference_model.predict(reference_model.parameters.center)


@pytest.fixture(scope="session")
def stable_model() -> LaxityModel:
    """The real knee whose four-line model is well posed, under the 63 trials."""
    return LaxityModel(knee=example("lenhart2015_stable"), protocol=load_protocol("seed63"))


@pytest.fixture(scope="session")
def small_model(tmp_path_factory: pytest.TempPathFactory) -> LaxityModel:
    """The small knee under its few trials, its map of the femur kept from other tests."""
    cache = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(laxity_model, "cache_folder", lambda: cache)
        return LaxityModel(knee=small_knee(), protocol=small_protocol())


@pytest.fixture
def short_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches for trials of a measured knee that bear their load end early.

    For tests of what is said of the table, whatever was found.
    """
    monkeypatch.setattr("identknee.checks.usable_trials.BUDGET", 40)


@pytest.fixture
def no_drawings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without what is drawn in them, which takes most of the time: for tests of words."""
    monkeypatch.setattr("identknee.report.page.page.inline_svg", lambda *_: "<svg></svg>")


@pytest.fixture
def no_conventions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Broken conventions are not looked for, which takes hundreds of simulations."""
    _without_conventions(monkeypatch)


def _without_conventions(patch: pytest.MonkeyPatch) -> None:
    for module in ("checks.fit_checks", "verbs.diagnose"):
        patch.setattr(f"identknee.{module}.convention_findings", lambda *_: ())


@pytest.fixture(scope="module")
def few_starts() -> Iterator[None]:
    """Searches of verbs begin at three points in place of seventeen."""
    with pytest.MonkeyPatch.context() as patch:
        use_few_starts(patch)
        yield


# Modules among these that are about conventions, or about what is found with them.
ABOUT_CONVENTIONS = frozenset(
    {"test_cli_fit", "test_cli_named_subjects", "test_brief", "test_identification"}
)


@pytest.fixture(scope="module", autouse=True)
def _no_conventions_of_whole_verbs(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent in FEW_STARTS and request.path.stem not in ABOUT_CONVENTIONS:
            _without_conventions(patch)
        yield


@pytest.fixture(scope="module", autouse=True)
def _few_starts_of_whole_verbs(request: pytest.FixtureRequest) -> None:
    if request.path.parent in FEW_STARTS:
        request.getfixturevalue("few_starts")
