"""Colour images with physically based light, by MuJoCo's Filament."""
