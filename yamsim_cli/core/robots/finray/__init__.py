"""Fin-ray fingers, generated from a few lengths and a modulus: two soft walls that meet at the tip, with ribs."""
