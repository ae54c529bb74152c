from .capsule import with_capsule as with_capsule
from .check import GeometryFinding as GeometryFinding
from .knee import Frame as Frame
from .knee import Ligament as Ligament
from .opensim_export import write_opensim as write_opensim
from .surface import Surface as Surface
from .surface import joined as joined
from .surface import write_surface as write_surface
