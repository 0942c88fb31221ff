"""KitchenBench's rigid tasks on the station with two arms, as an embodiment of Inspect Robots, and an expert for them.

Needs `yamsim[inspect]`. `inspect-robots` finds `yamsim` and `yamsim_expert` by their entry points.
"""
