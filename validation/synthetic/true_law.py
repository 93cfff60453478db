"""The law of a body whose scene takes it for another: the same stiffness at small strain, another form."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bcid.forms.model import Model
from bcid.scene import Material, Scene
from bcid.scene.parts import Values
from validation.synthetic.chance import Rng, log_uniform


@dataclass(frozen=True)
class TrueLaw:
    """A law of the same initial shear and bulk modulus as the scene's.

    Attributes:
        name: "gent", "mooney_rivlin" or "yeoh".
        form: what makes it differ: jm of Gent, the share of c01 in the shear modulus of Mooney-Rivlin, c2/c1 of Yeoh.
    """

    name: str
    form: float

    @classmethod
    def draw(cls, rng: Rng) -> TrueLaw:
        """Any that departs moderately at the strains of the study."""
        forms = {
            "gent": log_uniform(rng, 2.0, 10.0),
            "mooney_rivlin": float(rng.uniform(0.2, 0.5)),
            "yeoh": float(rng.uniform(0.05, 0.15)),
        }
        name = str(rng.choice(list(forms)))
        return cls(name, forms[name])

    def scene(self, scene: Scene) -> Scene:
        """The scene with this law; Young's modulus and Poisson's ratio at small strain stay."""
        model = Model.of(scene)
        constants = model.law.complete(model.values)
        shear = float(model.law.shear(constants))
        values = self._values(shear) | {"poisson": float(constants["poisson"])}
        return replace(scene, material=Material(self.name, values, scene.material.formulation))

    def _values(self, shear: float) -> Values:
        """Its constants as a scene has them, for an initial shear modulus (Pa)."""
        if self.name == "gent":
            return {"mu": f"{shear!r} Pa", "jm": self.form}
        first, second = ("c10", "c01") if self.name == "mooney_rivlin" else ("c1", "c2")
        kept = 1 - self.form if self.name == "mooney_rivlin" else 1.0
        return {first: f"{kept * shear / 2!r} Pa", second: f"{self.form * shear / 2!r} Pa"}
