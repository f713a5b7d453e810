"""Learning beside a running edge: collect, train elsewhere, swap only what is better. No torch."""

from e3pose.learning.online import OnlineTrainer as OnlineTrainer
from e3pose.learning.settings import LearningSettings as LearningSettings
from e3pose.learning.versions import Version as Version
