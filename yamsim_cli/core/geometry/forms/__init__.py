"""Things made from a handful of sizes: how they look, collide and can be held. One module for each way of making."""
