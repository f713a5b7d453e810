"""Simulated recordings: people, cameras and imperfect detectors, with exact truth."""

from e3pose.simulate.scenes import SCENES as SCENES
from e3pose.simulate.settings import DetectorSettings as DetectorSettings
from e3pose.simulate.settings import Guessing as Guessing
from e3pose.simulate.settings import SceneSettings as SceneSettings
from e3pose.simulate.settings import adjusted as adjusted
from e3pose.simulate.simulation import simulate as simulate
