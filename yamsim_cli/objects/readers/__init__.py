"""Read object files in a child process with limits. The entry point is `object_reader.read_object`."""

# Endings of supported files, kept here so that no reader needs to be imported for them.
ENDINGS = (".sdf", ".glb", ".gltf", ".obj", ".stl", ".ply", ".dae", ".urdf", ".xml", ".mjcf")
