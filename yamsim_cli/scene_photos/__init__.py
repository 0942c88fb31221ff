"""Photos in scenes: a photo as the background of a fixed camera, and a photo of the table's surface."""
