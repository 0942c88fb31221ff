"""The one engine in which anything acts: a scene in motion, its goal, and how an attempt ends.

- `episode`: `Episode`, which steps a scene, judges its goal after every control tick, and keeps what is recorded.
- `rules`: what may end an episode, and who decides that.
- `grasps`: how hands hold things: by friction, by a weld, or cloth by a constraint.
- `monitor`: joint limits, forbidden contacts and broken physics.
- `commands`: drive commands that follow planned paths.
"""
