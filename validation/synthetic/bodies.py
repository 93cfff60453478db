"""The bodies of the hidden study: a slab, a gallbladder, and a finger that bends.

Lengths are in m. In the sets of the gallbladder each patch moves the fiducials by 0.1 mm (RMS) or more under typical motions, in
those of the finger by 0.06 mm.
"""

from __future__ import annotations

from itertools import combinations

from bcid.base.errors import InputError, nearest
from bcid.scene import Level
from validation.synthetic.study_body import Ball, Obstacle, Sets, StudyBody, Way


def _slab_sets() -> Sets:
    """Sets of one to four patches; one edge alone does not hold soundly, a bottom quarter does."""
    # On the anchored bottom quarters 7 and 8 the edges beside them do not move: nothing could tell whether they are held.
    shielded = ({"7", "2"}, {"7", "3"}, {"8", "4"}, {"8", "5"})
    every = [s for count in range(1, 5) for s in combinations("12345678", count)]
    return tuple(s for s in every if (len(s) > 1 or s[0] in "78") and not any(pair <= set(s) for pair in shielded))


def _sets(words: str) -> Sets:
    """Sets of patches with names of one letter: "1 12 134"."""
    return tuple(tuple(word) for word in words.split())


# Sheared far in its plane the slab buckles.
_SHEAR = (6e-3, 9e-3)
_FAR = (6e-3, 16e-3)

SLAB = StudyBody(
    name="slab",
    scene="examples/scenes/slab_hidden.toml",
    sound=_slab_sets(),
    grasps={"I": (0.090, 0.005, 0.020), "II": (0.090, 0.005, 0.050), "III": (0.090, 0.005, 0.080)},
    beside={"I": frozenset("6"), "III": frozenset("1")},
    ways={
        "x": Way((1.0, 0.0, 0.0), _FAR),
        "z": Way((0.0, 0.0, 1.0), _SHEAR),
        "-z": Way((0.0, 0.0, -1.0), _SHEAR),
        "up": Way((0.0, 1.0, 0.0), _FAR),
        "x and up": Way((0.8, 0.6, 0.0), _FAR),
        "x and z": Way((0.8, 0.0, 0.6), _FAR, crowded=_SHEAR),
        "x and -z": Way((0.8, 0.0, -0.6), _FAR, crowded=_SHEAR),
    },
    pull="x",
    across=("z", "-z", "x and z", "x and -z"),
    lift="up",
    axis=(1.0, 0.0, 0.0),
    fiducials=16,
    ball=Ball((0.025, 0.075), (0.005, 0.005), (0.025, 0.075), (0.008, 0.020)),
    obstacle=Obstacle((0.055, 0.075), 0.015, 0.010, (0.015, 0.100)),
    true=Level(degree=3, element_size=0.014),
    coarse=Level(degree=2, element_size=0.020),
)

GALLBLADDER = StudyBody(
    name="gallbladder",
    scene="examples/scenes/gallbladder_hidden.toml",
    sound=_sets(
        "1 2 3 4 5 6 12 13 14 15 16 23 24 25 26 34 35 36 45 46 56 124 125 126 134 135 136 235 236 245 246 256 346 356"
    ),
    grasps={"neck": (0.0732, 0.0113, 0.0083)},
    ways={
        # The neck points up and to the side.
        "along": Way((0.60, 0.64, 0.48), (5e-3, 12e-3)),
        "x": Way((1.0, 0.0, 0.0), (5e-3, 12e-3)),
        "z": Way((0.0, 0.0, 1.0), (5e-3, 12e-3)),
        "-z": Way((0.0, 0.0, -1.0), (5e-3, 12e-3)),
        "up": Way((0.0, 1.0, 0.0), (6e-3, 14e-3)),
        "up and z": Way((0.0, 0.8, 0.6), (6e-3, 14e-3)),
        "up and -z": Way((0.0, 0.8, -0.6), (6e-3, 14e-3)),
    },
    pull="along",
    across=("z", "-z", "up and z", "up and -z"),
    lift="up",
    # What it is made of shows little in how it moves: it is seen from near.
    noise=(3e-5, 2e-4),
    axis=(0.60, 0.64, 0.48),
    fiducials=9,
    ball=Ball((0.014, 0.048), (-0.003, 0.004), (-0.006, 0.006), (0.006, 0.012)),
    obstacle=Obstacle((0.030, 0.050), 0.010, 0.014, (0.015, 0.100)),
    supported=False,
    true=Level(degree=3, element_size=0.0055),
    coarse=Level(degree=2, element_size=0.010),
)

FINGER = StudyBody(
    name="finger",
    scene="examples/scenes/finger_hidden.toml",
    sound=_sets("1 2 3 4 5 6 12 13 14 15 16 23 24 25 26 34 35 36 45 46 56 145 156 235 256 345 346 356 456"),
    grasps={"tip": (0.085, 0.003, 0.015), "middle": (0.063, 0.003, 0.015)},
    ways={
        "x": Way((1.0, 0.0, 0.0), (4e-3, 8e-3)),
        "z": Way((0.0, 0.0, 1.0), (5e-3, 10e-3)),
        "-z": Way((0.0, 0.0, -1.0), (5e-3, 10e-3)),
        "up": Way((0.0, 1.0, 0.0), (8e-3, 14e-3)),
        "x and up": Way((0.6, 0.8, 0.0), (6e-3, 12e-3)),
        "up and z": Way((0.0, 0.8, 0.6), (6e-3, 12e-3)),
        "up and -z": Way((0.0, 0.8, -0.6), (6e-3, 12e-3)),
    },
    pull="x",
    across=("z", "-z", "up and z", "up and -z"),
    lift="up",
    # As above; how a thin body bends tells even less.
    noise=(2e-5, 1e-4),
    axis=(1.0, 0.0, 0.0),
    twist=(10.0, 20.0),
    fiducials=14,
    ball=Ball((0.020, 0.056), (0.003, 0.003), (0.006, 0.024), (0.006, 0.012)),
    obstacle=Obstacle((0.045, 0.060), 0.008, 0.006, (0.015, 0.100)),
    true=Level(degree=3, element_size=0.007),
    coarse=Level(degree=2, element_size=0.010),
)

BODIES = {body.name: body for body in (SLAB, GALLBLADDER, FINGER)}


def check_bodies(names: tuple[str, ...]) -> None:
    """Refuse a body that does not exist, or is named twice."""
    for name in names:
        if name not in BODIES:
            raise InputError(f"--bodies: no body '{name}'; {nearest(name, BODIES)}")
    if len(set(names)) < len(names):
        raise InputError(f"--bodies {','.join(names)}: one is named twice")
