"""Networks like OpenPose as data: input, output channels, thresholds.

Such a network gives one heatmap per part and, per limb, a field of unit vectors along it (part
affinity). A new one is a new row here.
"""

from __future__ import annotations

from dataclasses import dataclass

from e3pose.model.skeleton import COCO18, Skeleton


@dataclass(frozen=True, slots=True)
class Topology:
    """One network's conventions.

    Attributes:
        name: how `make_detector` knows it.
        parts: joint name of each heatmap, in channel order.
        limbs: part index, part index, then the affinity channels of x and y; the field points from
            the first part to the second.
        outputs: channels of each output; heatmaps come first when they are put together.
        affinity_start: channel of affinity channel 0 when all outputs are put together.
        bgr: whether the input's channels are blue, green, red.
        mean: subtracted from the input of 0..255, per input channel.
        deviation: then divides it.
        long_side: of the input in pixels, where the network leaves it free.
        multiple: both sides of the input are multiples of this.
        keep_proportions: pad the image rather than stretch it, as in training.
        upsample: heatmaps are enlarged this much before peaks are sought.
        blur_cells: sigma of the Gaussian over the enlarged heatmaps, in enlarged cells.
        peak_threshold: of the smoothed heatmap.
        samples: points along a limb at which the field is read.
        sample_threshold: a point speaks for the limb if the field along it exceeds this.
        min_samples: so many points must.
        min_mean: and their mean must exceed this.
        min_parts: fewer make no person.
        skeleton: of the poses returned.
    """

    name: str
    parts: tuple[str, ...]
    limbs: tuple[tuple[int, int, int, int], ...]
    outputs: tuple[int, ...]
    affinity_start: int
    bgr: bool
    mean: tuple[float, float, float]
    deviation: tuple[float, float, float]
    long_side: int
    multiple: int
    keep_proportions: bool
    upsample: int
    blur_cells: float
    peak_threshold: float
    samples: int
    sample_threshold: float
    min_samples: int
    min_mean: float
    min_parts: int = 4
    skeleton: Skeleton = COCO18


OPENPOSE_THIN = Topology(
    name="openpose-thin",
    parts=COCO18.joints,
    limbs=(
        (1, 2, 12, 13), (1, 5, 20, 21), (2, 3, 14, 15), (3, 4, 16, 17), (5, 6, 22, 23),
        (6, 7, 24, 25), (1, 8, 0, 1), (8, 9, 2, 3), (9, 10, 4, 5), (1, 11, 6, 7),
        (11, 12, 8, 9), (12, 13, 10, 11), (1, 0, 28, 29), (0, 14, 30, 31), (14, 16, 34, 35),
        (0, 15, 32, 33), (15, 17, 36, 37), (2, 16, 18, 19), (5, 17, 26, 27),
    ),
    outputs=(57,),
    affinity_start=19,  # 18 parts and the background
    bgr=True,
    mean=(0.0, 0.0, 0.0),
    deviation=(1.0, 1.0, 1.0),
    long_side=432,
    multiple=16,
    keep_proportions=True,
    upsample=4,
    blur_cells=2.5,
    peak_threshold=0.15,
    samples=10,
    sample_threshold=0.05,
    min_samples=7,
    min_mean=0.0,
)  # fmt: skip

_TRT_PARTS = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip",
    "left_knee", "right_knee", "left_ankle", "right_ankle", "neck",
)  # fmt: skip
# `skeleton` of trt_pose's human_pose.json, counted from 0.
_TRT_LIMBS = (
    (15, 13), (13, 11), (16, 14), (14, 12), (11, 12), (5, 7), (6, 8), (7, 9), (8, 10), (1, 2),
    (0, 1), (0, 2), (1, 3), (2, 4), (3, 5), (4, 6), (17, 0), (17, 5), (17, 6), (17, 11), (17, 12),
)  # fmt: skip

# ResNet18 with attention heads, 224x224: the paper's network.
TRT_POSE = Topology(
    name="trt-pose",
    parts=_TRT_PARTS,
    # trt_pose writes rows before columns: channel 2k is y, 2k + 1 is x.
    limbs=tuple((a, b, 2 * k + 1, 2 * k) for k, (a, b) in enumerate(_TRT_LIMBS)),
    outputs=(18, 42),
    affinity_start=18,
    bgr=False,
    mean=(123.675, 116.28, 103.53),
    deviation=(58.395, 57.12, 57.375),
    long_side=224,
    multiple=32,
    keep_proportions=False,  # its training squeezed every photograph into the square
    upsample=2,
    blur_cells=1.0,
    peak_threshold=0.1,
    samples=7,
    sample_threshold=0.0,
    min_samples=0,
    min_mean=0.1,
)

TOPOLOGIES = {row.name: row for row in (OPENPOSE_THIN, TRT_POSE)}
