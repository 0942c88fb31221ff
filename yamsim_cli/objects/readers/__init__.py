"""Read object files in a child process with limits. The entry point is `object_reader.read_object`."""

# Kept here so that no reader is imported for them.
OBJECT_SUFFIXES = (".sdf", ".glb", ".gltf", ".obj", ".stl", ".ply", ".dae", ".urdf", ".xml", ".mjcf")
