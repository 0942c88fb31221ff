"""Readers of files of things, which run in a child process with limits; see `read.read_object`."""

# The file types that are read. Nothing else is loaded to know them.
ENDINGS = (".sdf", ".glb", ".gltf", ".obj", ".stl", ".ply", ".dae", ".urdf", ".xml", ".mjcf")
