"""
How is a slab held?
===================

Find the anchored patches of a slab from a shipped measurement, with the Python API.

::

    ./dev python examples/01_identify.py
"""

from pathlib import Path

from bcid import Measurement, Scene, identify
from bcid.api.results import IdentifyResult

HERE = Path(__file__).resolve().parent


def main() -> IdentifyResult:
    """The whole job."""
    scene = Scene.read(HERE / "scenes/slab.toml")
    measurement = Measurement.read(HERE / "measurements/slab-34-complex")
    found = identify(scene, measurement)

    print(found.headline)
    print(found.to_dataframe().head(4).to_string(index=False))
    return found


if __name__ == "__main__":
    main()
