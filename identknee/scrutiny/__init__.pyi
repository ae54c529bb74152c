from .against_load import against_load_findings as against_load_findings
from .broken_convention import BrokenConvention as BrokenConvention
from .broken_convention import convention_findings as convention_findings
from .broken_convention import find_broken_convention as find_broken_convention
from .conventions import Convention as Convention
from .conventions import conventions_of as conventions_of
