from .case import BlindCase as BlindCase
from .effects import LISTED as LISTED
from .effects import UNLISTED as UNLISTED
from .folder import write_blind as write_blind
from .scoring import Score as Score
from .scoring import score as score
from .truth import Truth as Truth
from .truth import read_truth as read_truth
