"""Flags that commands share, and what comes of them before a command starts."""
