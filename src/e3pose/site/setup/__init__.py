"""Set up a site in a browser: the server of `e3pose setup`, its steps and their background tasks.

Each step calls what the command line calls and writes the same files; what was chosen before there
is a site file is kept beside it, so that a reload or a restart goes on where it was.
"""
