"""Meshes: loaded in a child process, checked, and held as arrays that are the same on every rank."""

from bcid.forms.mesh.body_mesh import BodyMesh
from bcid.forms.mesh.check import checked
from bcid.forms.mesh.loading import level_mesh, level_name

__all__ = ["BodyMesh", "checked", "level_mesh", "level_name"]
