"""Which files are read, by their endings. Nothing else is loaded to know that."""

from __future__ import annotations

ENDINGS = (".sdf", ".glb", ".gltf", ".obj", ".stl", ".ply", ".dae", ".urdf", ".xml", ".mjcf")
