"""
What does its model lack?
=========================

Find what a slab's model lacks from a shipped measurement, with the Python API.

::

    ./dev python examples/02_explain.py
"""

from pathlib import Path

from bcid import Measurement, Scene, explain
from bcid.api.results import DiagnosisResult

HERE = Path(__file__).resolve().parent


def main() -> DiagnosisResult:
    """The whole job."""
    scene = Scene.read(HERE / "scenes/slab_explain.toml")
    measurement = Measurement.read(HERE / "measurements/slab-34-heavy")
    found = explain(scene, measurement)

    print("missing:", found.verdict)
    for model in found.ladder:
        print(f"{model.model}, anchors {' '.join(model.anchored)}: {model.rms * 1e3:.3f} mm")
    for name, number in found.parameters.items():
        print(f"{name} = {number['value']:.0f} ± {number['stderr']:.0f} {number['unit']}")
    return found


if __name__ == "__main__":
    main()
