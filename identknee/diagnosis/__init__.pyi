from .explanations.causes import causes_of as causes_of
from .explanations.fitting import fit_base as fit_base
from .explanations.refit import Refit as Refit
from .gain.folds import Fold as Fold
from .gain.folds import observations_of as observations_of
from .gain.gain import elpd_difference as elpd_difference
from .gain.held_out import HeldOut as HeldOut
from .gain.held_out import held_out as held_out
