"""Goals of tasks: predicates over the state of a scene, each with a margin."""
