"""An effect on the setting whose amplitudes are combinations of other ones."""

from identknee.model.effects.effect import CopiesEffect
from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry


@declared
class Recombined:
    """An effect on the setting at amplitudes ``matrix @ values``."""

    effect: CopiesEffect = entry("The effect, of n amplitudes")
    matrix: Array = entry("Shape ``(n, k)``")
    parameters: Parameters = entry("The k amplitudes that are combined")

    @property
    def name(self) -> str:
        """Name of the cause."""
        return self.effect.name

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with the effect."""
        return self.effect.change(setting, self.matrix @ values)

    def change_copies(self, setting: Setting, values: Array) -> Setting:
        """The setting with the effect at amplitudes ``values[i]`` in copy i."""
        return self.effect.change_copies(setting, values @ self.matrix.T)
