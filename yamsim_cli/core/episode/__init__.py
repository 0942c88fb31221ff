"""The episode engine: simulates attempts at a task, with the same scene, goal and end rules for every actor.

- `episode`: `Episode`, which steps a scene, judges its goal after every control tick, and keeps the recorded states.
- `episode_rules`: which events end an episode, and which of them fail it.
- `grasps`: how hands hold objects: by friction, by a weld, or cloth by a constraint.
- `held_objects`: measures how far objects slip and tilt in hands.
- `monitor`: watches joint limits, forbidden contacts and unstable physics.
- `commands`: drive commands that make arms follow planned paths.
"""
