"""The engine in which every actor acts: a scene in motion, its goal, and how an attempt ends.

- `episode`: `Episode`, which steps a scene, judges its goal after every control tick, and keeps what is recorded.
- `rules`: which events end an episode, and which of them fail it.
- `grasps`: how hands hold things: by friction, by a weld, or cloth by a constraint.
- `held`: how far things slip and tilt in hands.
- `monitor`: joint limits, forbidden contacts and broken physics.
- `commands`: drive commands that follow planned paths.
"""
