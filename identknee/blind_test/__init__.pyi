from .blind_data import BlindData as BlindData
from .blind_data import Revelation as Revelation
from .blind_data import make_blind as make_blind
from .blind_data import reveal as reveal
