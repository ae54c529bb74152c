"""Knee ligament calibrations, and how far they can be trusted.

Read a knee          read_subject, example, import_opensim, check_geometry
Read its laxity      read_laxity, example_laxity, load_protocol, add_noise
Simulate, calibrate  simulate, fit, sweep
What is known        profile, sample, information, equivalents, sensitivity
What is wrong        diagnose, isolability
What to test next    design
See and keep it      compare, report, scene, scene_3d, load, write_laxity, write_subject

    import identknee as ik
    knee = ik.reference_knee()
    answer = ik.fit(knee, ik.simulate(knee, noise="0.3mm,0.3deg").noisy, start="IG2")
    ik.report(answer, "report.html")

An answer prints as sentences and shows table and figure in a notebook. help(ik.fit) explains one
function; the packages below hold the rest, such as ik.identify.geodesics.
"""

# Names load when they are first used, so that ``identknee --help`` waits for no compiler. There is
# no ``__all__``: help() would print all documentation of all names.
from lazy_loader import attach_stub

from identknee.runs.notebooks import show_in_notebooks
from identknee.verbs.printer import Printer, set_printer
from identknee.verbs.registry import Verb, register

__version__ = "0.3.0"


def _printer() -> Printer:
    from identknee.report import printer

    return printer


def _shown(given: object) -> object:
    from identknee.report.notebook import shown

    return shown(given)  # type: ignore[arg-type]


# What verbs may not import, because it stands above them, is given to them here.
set_printer(_printer)
show_in_notebooks(
    (
        ("identknee.subject.knee", "Knee"),
        ("identknee.laxity.table", "Laxity"),
        ("identknee.laxity.protocol", "Protocol"),
        ("identknee.model.laxity_model", "LaxityModel"),
    ),
    _shown,
)
register(
    Verb(
        name="blind",
        module="identknee.blind_test.blind_data",
        function="make_blind",
        answer="BlindData",
        summary="Make laxity data with a hidden effect, to test a diagnosis.",
        example="reference --seed 7 --effect random --out blind7",
        folder="identknee-blind",
    )
)
register(
    Verb(
        name="compare",
        module="identknee.report.comparison",
        answer="Comparison",
        summary="Set results side by side, and see what differs.",
        example="fit-intact fit-cut --name intact --name cut",
        is_reported=True,
        has_pictures=True,
        then="Next: identknee report {out}",
    )
)
register(
    Verb(
        name="subject export",
        module="identknee.report.export",
        function="export_subject",
        answer="SubjectFacts",
        summary="Write SUBJECT as a subject folder, and for other tools.",
        example="reference --out my-knee",
        folder="identknee-subject",
        then="Next: identknee subject check {out}",
    )
)
_named, __dir__, _ = attach_stub(__name__, __file__)
del attach_stub, set_printer, register, Verb


def __getattr__(name: str) -> object:
    """A public name; one that a package holds is found there, with a warning that says where."""
    try:
        return _named(name)
    except AttributeError:
        from pkgutil import iter_modules

        from identknee.runs.packages import held_by_package

        packages = {x.name: _named(x.name) for x in iter_modules(__path__) if x.name in __dir__()}
        if not name.startswith("_") and (package := held_by_package(packages, __name__, name)):
            return getattr(package, name)
        raise
