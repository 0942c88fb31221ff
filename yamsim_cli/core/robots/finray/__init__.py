"""Fin-ray fingers: two soft walls that meet at the tip, with ribs between them, from a few lengths and a modulus."""
