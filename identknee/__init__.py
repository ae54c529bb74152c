"""Knee ligament calibrations, and how far they can be trusted.

Read a knee          read_subject, example, import_opensim, check_geometry
Read its laxity      read_laxity, example_laxity, load_protocol, add_noise
Simulate, calibrate  simulate, fit, sweep
What is known        profile, sample, information, equivalents, sensitivity
What is wrong        diagnose, isolability
What to test next    design
See and keep it      report, scene, scene_3d, load, write_laxity, write_subject

    import identknee as ik
    knee = ik.reference_knee()
    answer = ik.fit(knee, ik.simulate(knee, noise="0.3mm,0.3deg").noisy, start="IG2")
    answer.plot()
    ik.report(answer, "report.html")

An answer prints as sentences and shows table and figure in a notebook. help(ik.fit) explains one
function; the packages below hold the rest, such as ik.identify.geodesics.
"""

# Names load when they are first used, so that ``identknee --help`` waits for no compiler. There is
# no ``__all__``: help() would print all documentation of all names.
from lazy_loader import attach_stub

__version__ = "0.1.0"
__getattr__, __dir__, _ = attach_stub(__name__, __file__)
del attach_stub
