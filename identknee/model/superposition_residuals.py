"""Names that `identknee.model.force_residuals` holds, for modules that others edit now."""

from identknee.model.force_residuals import SuperpositionResiduals as SuperpositionResiduals
from identknee.model.force_residuals import weighed as weighed
