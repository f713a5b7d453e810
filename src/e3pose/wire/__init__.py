"""Messages between cameras, edge and users, and their transport.

    messages -> codec -> topics -> transport (memory: one process; network: zenoh)

`docs/reference/messages.md` is the format, for programs of others.
"""
