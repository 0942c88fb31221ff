"""Goals of tasks: predicates over a world, each with its margin."""
