"""Goals of tasks: predicates over the state of a scene, each with the margin by which it holds or fails."""
