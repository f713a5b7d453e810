"""Noise models: sigma of a detector's keypoints by score (docs/explanation/keypoint-noise.md)."""

from e3pose.model.noises.file import NoiseFile as NoiseFile
from e3pose.model.noises.file import ViewFigures as ViewFigures
from e3pose.model.noises.file import decode_noise as decode_noise
from e3pose.model.noises.file import encode_noise as encode_noise
from e3pose.model.noises.shipped import DEFAULT as DEFAULT
from e3pose.model.noises.shipped import SHIPPED as SHIPPED
from e3pose.model.noises.shipped import detector_of as detector_of
from e3pose.model.noises.shipped import load_noise as load_noise
from e3pose.model.noises.shipped import load_noise_file as load_noise_file
