"""Whether a task is what it says: it can be done, and nothing but doing it counts."""
