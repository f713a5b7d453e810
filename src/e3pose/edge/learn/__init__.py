"""Online learning beside a running edge: collect, train, validate, replace. No torch."""

from e3pose.edge.learn.learner import OnlineTrainer as OnlineTrainer
from e3pose.edge.learn.settings import LearningSettings as LearningSettings
from e3pose.edge.learn.versions import Version as Version
