"""The scene: what is known of the body before it is pulled; its TOML file; motions of the gripper."""

from bcid.scene.action import Action
from bcid.scene.parts import Box, Grasp, Level, Limits, Material, Plane, Region, Values
from bcid.scene.scene import PhysicsCheck, Scene

__all__ = [
    "Action",
    "Box",
    "Grasp",
    "Level",
    "Limits",
    "Material",
    "PhysicsCheck",
    "Plane",
    "Region",
    "Scene",
    "Values",
]
