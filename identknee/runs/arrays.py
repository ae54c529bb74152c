"""Names that `identknee.runs.declare` holds, for modules that others edit now."""

from identknee.runs.declare import CHECK_UNITS as CHECK_UNITS
from identknee.runs.declare import Array as Array
from identknee.runs.declare import BitArray as BitArray
from identknee.runs.declare import BoolArray as BoolArray
from identknee.runs.declare import IntArray as IntArray
from identknee.runs.declare import ReachArray as ReachArray
from identknee.runs.declare import frozen as frozen
from identknee.runs.declare import frozen_integers as frozen_integers
from identknee.runs.declare import implausible_coordinates as implausible_coordinates
from identknee.runs.declare import short_repr as short_repr
