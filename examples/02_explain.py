"""
What does its model lack?
=========================

Find what a slab's model lacks from a shipped measurement, with the Python API.

::

    ./dev python examples/02_explain.py
"""

from pathlib import Path

from mpi4py import MPI

from bcid import Explanation, Measurement, Scene, Twin, explain

HERE = Path(__file__).resolve().parent


def main() -> Explanation:
    """The whole job."""
    scene = Scene.read(HERE / "scenes/slab_explain.toml")
    measurement = Measurement.read(HERE / "measurements/slab-34-heavy")
    twin = Twin(scene, measurement, MPI.COMM_WORLD)
    found = explain(twin)

    print("missing:", found.verdict)
    for rung in found.rungs:
        anchors = " ".join(sorted(rung.state.anchors))
        print(
            f"{rung.state.model.name}, anchors {anchors}: {rung.state.rms * 1e3:.3f} mm, noise {rung.state.noise * 1e3:.3f} mm"
        )
    for name, error in found.last.fitted.stderr.items():
        print(f"{name} = {found.last.state.model.constants()[name]:.0f} ± {error:.0f}")
    twin.destroy()
    return found


if __name__ == "__main__":
    main()
