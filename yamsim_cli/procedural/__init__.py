"""Procedural looks: textures of surfaces and kinds of lights, generated from seeds without any picture."""
