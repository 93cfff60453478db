"""The strain energy density that pictures show."""

from dataclasses import replace

import numpy as np
import pytest

from bcid.forms.forward import Forward
from bcid.scene import Scene
from bcid.scene.motions import motion


def test_it_adds_up_to_the_energy_of_the_body(project: object) -> None:
    scene = Scene.read(f"{project}/examples/scenes/slab.toml")
    pulled = motion("pull", "II", steps=2)
    forward = Forward(replace(scene, levels=scene.levels[:1]))
    try:
        kept = forward.predict(["3", "4"], pulled, keep=True)
        found = forward.detail(["3", "4"], pulled, kept)
        density, strain = found.energy, forward.strain_energy
        assert density is not None
        assert density.shape == (3, len(forward.mesh.points))
        np.testing.assert_allclose(density[0], 0.0, atol=1e-12)
        # The last frame is the state that is left.
        assert strain._volume.sum() == pytest.approx(100e-6, rel=1e-12)
        assert density[-1] @ strain._volume == pytest.approx(forward.equilibrium.energy(), rel=1e-12)
        # Twice as far is about four times as much, and nowhere negative by more than the projection does.
        assert density[2] @ strain._volume == pytest.approx(4 * density[1] @ strain._volume, rel=0.2)
    finally:
        forward.destroy()


def test_a_uniform_stretch_has_the_energy_of_the_law(project: object) -> None:
    """A body that is held and driven on all of its boundary by an affine map has W(F) everywhere."""
    scene = Scene.read(f"{project}/examples/scenes/slab.toml")
    forward = Forward(replace(scene, levels=scene.levels[:1]))
    try:
        equilibrium = forward.equilibrium
        stretch = 1.2
        nodes = forward.body.nodes
        moved = np.zeros_like(nodes)
        moved[:, 0] = (stretch - 1) * nodes[:, 0]
        equilibrium.u.x.array[: 3 * len(nodes)] = moved.ravel()
        values = scene.material.values
        young, poisson = 15e3, float(values["poisson"])
        shear, lame = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        # Neo-Hookean, compressible: mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2 (Bonet & Wood 2008, eq. 6.28).
        expected = shear / 2 * (stretch**2 - 1) - shear * np.log(stretch) + lame / 2 * np.log(stretch) ** 2
        np.testing.assert_allclose(forward.strain_energy.at_mesh_nodes(), expected, rtol=1e-12)
    finally:
        forward.destroy()
