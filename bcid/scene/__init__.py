"""The scene: what is known of the body before it is pulled; its TOML file; motions of the gripper."""

from bcid.scene.action import Action
from bcid.scene.parts import Box, Facing, Grasp, Level, Limits, Material, Painted, Plane, Region, Sphere, Values
from bcid.scene.scene import PhysicsCheck, Scene

__all__ = [
    "Action",
    "Box",
    "Facing",
    "Grasp",
    "Level",
    "Limits",
    "Material",
    "Painted",
    "PhysicsCheck",
    "Plane",
    "Region",
    "Scene",
    "Sphere",
    "Values",
]
