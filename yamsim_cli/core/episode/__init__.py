"""The episode engine: every actor acts in the same scene, with the same goal and rules for the end of an attempt.

- `episode`: `Episode`, which steps a scene, judges its goal after every control tick, and keeps the recorded states.
- `episode_rules`: which events end an episode, and which of them fail it.
- `grasps`: how hands hold objects: by friction, by a weld, or cloth by a constraint.
- `held_objects`: how far objects slip and tilt in hands.
- `monitor`: joint limits, forbidden contacts and unstable physics.
- `commands`: drive commands that follow planned paths.
"""
