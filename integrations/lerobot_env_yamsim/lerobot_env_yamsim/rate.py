"""Frames a second that are no whole number, for whoever expects one."""

from __future__ import annotations

from fractions import Fraction


class Rate(float):
    """A number with a numerator and a denominator: LeRobot hands rates to JSON, and to PyAV, which asks for both."""

    @property
    def numerator(self) -> int:
        """Of the nearest fraction with a small denominator."""
        return self._fraction.numerator

    @property
    def denominator(self) -> int:
        """Of the same."""
        return self._fraction.denominator

    @property
    def _fraction(self) -> Fraction:
        return Fraction(self).limit_denominator(10_000)


def rate_of(fps: float) -> int | Rate:
    """A rate as a whole number where it is one."""
    return int(fps) if fps == int(fps) else Rate(fps)
