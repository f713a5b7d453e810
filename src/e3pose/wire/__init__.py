"""What cameras and the edge say to each other, and how it travels.

    messages -> codec -> topics -> transport (memory: one process; network: zenoh)

`docs/reference/messages.md` is the format, for programs of others.
"""
