"""Terminal output of commands (results, progress, tables) and handling of Ctrl-C."""
