"""How the anchored patches are identified."""

from __future__ import annotations

from dataclasses import dataclass

from bcid.base.errors import InputError, nearest
from bcid.scene import Scene
from bcid.search.settings import SETTINGS
from bcid.search.stages import StageOptions

CERTIFY = ("auto", "yes", "no")
# With more patches not every set can be followed.
_MOST_PATCHES = 16


@dataclass(frozen=True)
class IdentifyOptions:
    """How the anchored patches are identified.

    Attributes:
        certify: which sets are followed until they have lost: "yes", every one; "auto", every one of up to 10 patches, and else
            those that differ from a likely one by two; "no", none: tangents and a few steps tell of them.
        level: of the ladder, that both meshes go by; by default the last with at most 40,000 unknowns.
        stages: climb to the sets to begin with in stages, as the paper does; by default a few steps show them.
    """

    certify: str = "auto"
    level: int | None = None
    stages: StageOptions | None = None

    def check(self, scene: Scene) -> None:
        """Raise `InputError` for options that the scene cannot serve."""
        levels, count = len(scene.levels), len(scene.patches)
        if self.certify not in CERTIFY:
            raise InputError(f"certify '{self.certify}': {nearest(self.certify, CERTIFY)}")
        if self.level is not None and not 0 <= self.level < levels:
            raise InputError(f"level {self.level}: the scene has levels 0 to {levels - 1}")
        if self.certify == "yes" and count > _MOST_PATCHES:
            raise InputError(
                f"certify: {count} patches have {2**count} sets; up to {_MOST_PATCHES} patches can be certified: use certify no"
            )
        if self.stages is not None:
            self.stages.check(scene)

    def certifies(self, scene: Scene) -> bool:
        """Whether every set is followed."""
        return self.certify == "yes" or (self.certify == "auto" and len(scene.patches) <= SETTINGS.few_patches)
