"""The station with two arms as an embodiment of Inspect Robots, for KitchenBench's tasks and yamsim's, with an expert.

Needs `yamsim[inspect]`. `inspect-robots` finds `yamsim` and `yamsim_expert` by their entry points.
"""
