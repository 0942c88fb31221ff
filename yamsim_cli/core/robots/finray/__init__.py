"""Fin-ray fingers: two soft walls that meet at the tip, with ribs; generated from a few lengths and a modulus."""
