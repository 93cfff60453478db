"""The scene file of a case: what an honest user states, and all that a diagnosis gets besides the measurement."""

from __future__ import annotations

import re
from pathlib import Path

from bcid.base.run_folder import write_whole
from bcid.base.units import quantity
from validation.synthetic.conditions import COARSE, COARSER, Conditions

FILE = "scene.toml"
_SIZE = re.compile(r'^element_size = "(.*)"$', re.MULTILINE)
_GEOMETRY = re.compile(r'^file = "(.*)"$', re.MULTILINE)


def write_scene(folder: Path, scene_file: Path, conditions: Conditions, noise: float) -> None:
    """Write `scene.toml` and the geometry beside it.

    Args:
        folder: of the case.
        scene_file: of the body.
        conditions: of the case.
        noise: true standard deviation of each coordinate, m.
    """
    text = scene_file.read_text(encoding="utf-8")
    found = _GEOMETRY.search(text)
    assert found is not None
    geometry = scene_file.parent / found[1]
    text = text.replace(found[0], f'file = "{geometry.name}"')
    if conditions.mesh == COARSE:
        text = _coarser(text)
    stated = conditions.stated(noise)
    if stated is not None:
        text = text.replace("[geometry]", f'noise_sigma = "{stated * 1e3:.4g} mm"\n\n[geometry]', 1)
    write_whole(folder / geometry.name, geometry.read_bytes())
    write_whole(folder / FILE, text)


def _coarser(text: str) -> str:
    """With larger elements on all levels but the first, which are large already."""
    sizes = list(_SIZE.finditer(text))[1:]
    for size in reversed(sizes):
        larger = f'element_size = "{quantity(size[1], "m") * COARSER * 1e3:.4g} mm"'
        text = text[: size.start()] + larger + text[size.end() :]
    return text
