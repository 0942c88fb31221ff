"""Files of things from elsewhere, read in a child process that opens nothing beside them and takes only its due.

`read.read_thing` is the way in; what comes back are plain numbers, in metres, z up.
"""
