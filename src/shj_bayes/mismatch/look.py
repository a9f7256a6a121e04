"""How to look for what a model leaves out: what users choose, apart from what looks."""

from dataclasses import dataclass

from shj_bayes.model.device import DeviceModel


@dataclass(frozen=True)
class Look:
    """What a diagnosis is asked for.

    Parameters
    ----------
    without : tuple of str
        ``velocity`` runs the base law without speed dependence; any other effect id is taken out of the catalogue.
    quick : bool
        A first look: no sampling of the posterior, approximate intervals.
    name : str
        Name of the device.
    """

    without: tuple[str, ...] = ()
    quick: bool = False
    name: str = "device"

    def hidden(self, device: DeviceModel) -> frozenset[str]:
        """Mechanisms that are not looked for: those taken out, and those that the model of the device has already."""
        speed = {"velocity"} if device.speed else set()
        return frozenset({*self.without, *(effect.mechanism for effect in device.effects)} - {"velocity"} | speed)
