from .blind_data import BlindData as BlindData
from .blind_data import make_blind as make_blind
from .revelation import Revelation as Revelation
from .revelation import reveal as reveal
