"""Online learning beside a running edge: collect, train, validate, replace. No torch."""

from e3pose.learn.online.learner import OnlineTrainer as OnlineTrainer
from e3pose.learn.online.settings import LearningSettings as LearningSettings
from e3pose.learn.online.versions import Version as Version
