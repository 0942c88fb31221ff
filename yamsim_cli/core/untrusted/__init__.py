"""Files that other people wrote: the one folder that they may name others in, and what MJCF includes."""
