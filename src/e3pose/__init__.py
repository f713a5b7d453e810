"""Multi-camera 3D human pose: wakes the most informative cameras that have energy budget.

The public names below are imported when they are first used, so that `import e3pose` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from e3pose.base.deferred import names_of

__version__ = "0.1.0"

if TYPE_CHECKING:
    from e3pose.base.errors import InputError as InputError
    from e3pose.cli.reconstructing import reconstruct as reconstruct
    from e3pose.estimate.per_slot.fuse import Fuser as Fuser
    from e3pose.evaluate.replay import ReplaySettings as ReplaySettings
    from e3pose.evaluate.replay import replay as replay
    from e3pose.model.camera import Camera as Camera
    from e3pose.model.camera import Rig as Rig
    from e3pose.model.people import People as People
    from e3pose.model.pose import Poses2D as Poses2D
    from e3pose.model.skeleton import SKELETONS as SKELETONS
    from e3pose.model.skeleton import Skeleton as Skeleton
    from e3pose.model.skeleton import load_skeleton as load_skeleton
    from e3pose.output.exports.frame import to_frame as to_frame
    from e3pose.output.exports.source import query as query
    from e3pose.output.report.plot import plot as plot
    from e3pose.recording import Recording as Recording
    from e3pose.recording import load_recording as load_recording
    from e3pose.recording import save_recording as save_recording
    from e3pose.recording.calibration import load_rig as load_rig
    from e3pose.recording.calibration import save_rig as save_rig
    from e3pose.site.camera_program import open_camera as open_camera
    from e3pose.site.connect import connect as connect
    from e3pose.site.edge_program import open_edge as open_edge

_HOMES = {
    "Camera": "model.camera",
    "Fuser": "estimate.per_slot.fuse",
    "InputError": "base.errors",
    "People": "model.people",
    "Poses2D": "model.pose",
    "Recording": "recording",
    "ReplaySettings": "evaluate.replay",
    "Rig": "model.camera",
    "SKELETONS": "model.skeleton",
    "Skeleton": "model.skeleton",
    "connect": "site.connect",
    "load_recording": "recording",
    "load_rig": "recording.calibration",
    "load_skeleton": "model.skeleton",
    "open_camera": "site.camera_program",
    "open_edge": "site.edge_program",
    "plot": "output.report.plot",
    "query": "output.exports.source",
    "reconstruct": "cli.reconstructing",
    "replay": "evaluate.replay",
    "save_recording": "recording",
    "save_rig": "recording.calibration",
    "to_frame": "output.exports.frame",
}


__getattr__ = names_of(__name__, _HOMES)


def __dir__() -> list[str]:
    return ["__version__", *sorted(_HOMES)]
