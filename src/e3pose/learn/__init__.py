"""Online learning beside a running edge: collect, train, validate, replace. No torch."""

from e3pose.learn.learner import OnlineTrainer as OnlineTrainer
from e3pose.learn.settings import LearningSettings as LearningSettings
from e3pose.learn.versions import Version as Version
