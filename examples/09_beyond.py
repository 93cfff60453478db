"""
Beyond the catalogue
====================

A slab is stuck at a spot that its scene does not name: no known effect explains how it moves, and a term that does is found.

The body that is pulled is made of cubic elements, and springs hold a round patch of its underside, away from every candidate
anchor. ``explain`` says "unknown". ``propose`` scores some thousand terms from one converged run, fits the most promising, and
writes the file of an effect (``stuck.py``), with which ``explain`` then comes down to the noise.

::

    ./dev python examples/09_beyond.py
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import ufl

import bcid
from bcid import ExplainOptions, Model, Scene, Term, motions
from bcid.forms import effects
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.model import check_physics
from bcid.forms.parameter import Amount
from bcid.scene import Level

HERE = Path(__file__).resolve().parent
PLACE, RADIUS = np.array([0.045, 0.0, 0.040]), 0.012


def springs(point: Any, c: Any) -> Any:
    """Springs on a disc with a soft edge: no formula of the grammar."""
    away = ufl.sqrt(ufl.inner(point.X - ufl.as_vector(PLACE.tolist()), point.X - ufl.as_vector(PLACE.tolist())) + 1e-12)
    disc = (1 - ufl.tanh((away - RADIUS) / (0.2 * RADIUS))) / 2
    skin = ufl.Measure("ds", domain=ufl.domain.extract_unique_domain(point.X), metadata={"quadrature_degree": 6})
    return c["stiffness"] / 2 * disc * ufl.inner(point.u, point.u) * skin


STUCK = BodyEffect(
    "stuck_disc",
    (Amount("stiffness", "Pa/m", "per area", neutral=0.0),),
    "the skin is stuck",
    potential=springs,
)


def main(folder: Path, known: tuple[str, ...] | None = None) -> tuple[str, str, float]:
    """Verdicts of `explain` without and with the proposed effect, and its distance from the true place, m.

    `known` are the effects of the catalogue that are looked at; all by default.
    """
    slab = Scene.read(HERE / "scenes" / "slab.toml", physics=check_physics)
    patches = {name: slab.patches[name] for name in ("2", "3", "4", "5")}
    scene = replace(slab, patches=patches, levels=(Level(2, 0.05), Level(2, 0.0095)), noise_sigma=0.3e-3)
    body = replace(scene, levels=(Level(3, 0.018),))
    ways = ((0.014, 0.0, 0.0), (0.006, 0.010, 0.0), (0.010, 0.0, -0.007), (0.004, 0.0, 0.009))
    straight = [np.arange(4)[:, None] / 3 * np.array(way) for way in ways]
    pulls = motions.actions([(way, np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))) for way in straight], "II")
    measured = bcid.simulate(
        body, ["3", "4"], pulls, noise=0.3e-3, model=Model.of(body) + Term(STUCK, {"stiffness": 5e5})
    )
    before = bcid.explain(scene, measured, options=ExplainOptions(only=known))
    print(f"explain: {before.verdict}, {1e3 * before.rms:.3g} mm left (noise {1e3 * before.noise_rms:.2g})")
    proposal = bcid.propose(scene, measured, name="stuck")
    print(proposal.headline)
    file = folder / "stuck.py"
    file.write_text(proposal.files["stuck"], encoding="utf-8")
    both = None if known is None else (*known, "stuck")
    after = bcid.explain(scene, measured, options=ExplainOptions(only=both), effects=[effects.load(file)])
    print(after.headline)
    values = {name: number.value for name, number in proposal.proposed[0].parameters.items()}
    away = float(np.linalg.norm([values["cx"], values["cy"], values["cz"]] - PLACE))
    print(f"the spot that was found is {1e3 * away:.1f} mm from the true one")
    return before.verdict, after.verdict, away


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        main(Path(made))
