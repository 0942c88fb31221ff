"""Flags that several commands share, and their evaluation before a command starts."""
