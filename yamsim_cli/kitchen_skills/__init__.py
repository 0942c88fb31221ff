"""Skills for kitchens: open a lid, pour, scoop, sort cutlery, and fold a cloth until it is small.

Programs find them by their entry points in the group `yamsim.skills`, as they find the skills of other packages.
"""
