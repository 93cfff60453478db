"""
How is a slab held?
===================

Find the anchored patches of a slab from a shipped measurement, with the Python API.

::

    ./dev python examples/01_identify.py
"""

from pathlib import Path

from bcid import Identification, Measurement, Scene, identify

HERE = Path(__file__).resolve().parent


def main() -> Identification:
    """The whole job."""
    scene = Scene.read(HERE / "scenes/slab.toml")
    measurement = Measurement.read(HERE / "measurements/slab-34-complex")
    found = identify(scene, measurement)

    print("anchored:", " ".join(found.anchored))
    print(f"probability {found.probability:.4f}, residual {found.rms * 1e3:.3f} mm, noise {found.noise * 1e3:.3f} mm")
    for other in found.alternatives[:3]:
        print("next best:", " ".join(other.anchored) or "none", f"probability {other.probability:.1e}")
    return found


if __name__ == "__main__":
    main()
