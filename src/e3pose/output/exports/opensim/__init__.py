"""OpenSim: a model, the set-ups of its tools, and joint angles as a motion file.

Written from OpenSim's documentation (https://opensimconfluence.atlassian.net and the API reference
of 4.x): the names of bodies and coordinates, the axes and signs are those that its full-body models
have in common, the lengths are those of `model.proportions`.
"""
