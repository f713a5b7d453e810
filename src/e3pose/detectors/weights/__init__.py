"""Weights of 2D pose networks: catalogue, download, verification."""

from e3pose.detectors.weights.catalogue import MODELS as MODELS
from e3pose.detectors.weights.catalogue import Network as Network
from e3pose.detectors.weights.fetch import Progress as Progress
from e3pose.detectors.weights.fetch import fetch_file as fetch_file
from e3pose.detectors.weights.index import fetch_from_index as fetch_from_index
from e3pose.detectors.weights.store import cache_folder as cache_folder
from e3pose.detectors.weights.store import find_weights as find_weights
from e3pose.detectors.weights.store import is_installed as is_installed
from e3pose.detectors.weights.store import pull_weights as pull_weights
from e3pose.detectors.weights.store import weights_path as weights_path
