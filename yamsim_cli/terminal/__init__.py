"""What a user sees of commands: results, progress, tables; and how Ctrl-C reaches them."""
