"""Laws that the scene of a case takes for a neo-Hookean one of the same stiffness at small strain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from bcid.forms import materials
from bcid.forms.model import Model
from bcid.scene import Material, Scene
from bcid.scene.parts import Values
from validation.synthetic.chance import Rng, log_uniform

# Constants that are drawn, as of rubber and tissue, for a shear modulus of 1 Pa.
_DRAWN: dict[str, Callable[[Rng], dict[str, float]]] = {
    "gent": lambda rng: {"mu": 1.0, "jm": log_uniform(rng, 0.2, 0.8)},
    "ogden": lambda rng: {"alpha1": float(rng.choice([-1, 1])) * log_uniform(rng, 6.0, 18.0)},
    "mooney_rivlin": lambda rng: _split(float(rng.uniform(0.5, 1.0))),
    "holzapfel_gasser_ogden": lambda rng: {
        "mu": 1.0,
        "k1": log_uniform(rng, 0.5, 4.0),
        "k2": log_uniform(rng, 2.0, 20.0),
        "angle": float(rng.uniform(0.0, 90.0)),
    },
    "fung": lambda rng: {
        "bf": log_uniform(rng, 12.0, 40.0),
        "bt": log_uniform(rng, 4.0, 12.0),
        "bfs": log_uniform(rng, 4.0, 12.0),
        "angle": float(rng.uniform(0.0, 90.0)),
    },
}
LAWS = tuple(_DRAWN)


def _split(share: float) -> dict[str, float]:
    """Mooney and Rivlin's two coefficients."""
    return {"c10": (1 - share) / 2, "c01": share / 2}


def true_scene(name: str, rng: Rng, scene: Scene) -> Scene:
    """The scene with this law; Poisson's ratio and the shear modulus at small strain stay (of Fung's law about)."""
    model = Model.of(scene)
    constants = model.law.complete(model.values)
    shear, poisson = float(model.law.shear(constants)), float(constants["poisson"])
    drawn = _DRAWN[name](rng)
    if name == "ogden":
        # mu_1 alpha_1 is twice the shear modulus.
        drawn["mu1"] = 2 / drawn["alpha1"]
    if name == "fung":
        # A mean of the coefficients stands for the isotropic one, c b = 2 shear.
        drawn["c"] = 6 / (drawn["bf"] + drawn["bt"] + drawn["bfs"])
    units = {p.name: p.unit for p in materials.law(name).parameters}
    values: Values = {"poisson": poisson}
    for key, value in drawn.items():
        if units[key] == "Pa":
            values[key] = f"{value * shear!r} Pa"
        else:
            values[key] = value if units[key] == "1" else f"{value!r} {units[key]}"
    return replace(scene, material=Material(name, values, scene.material.formulation))
