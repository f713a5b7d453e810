"""The filtering estimator: one causal Kalman filter per person, updated by any views.

    predict -> associate -> update -> existence -> births

A step is a pure function: the belief of the slot before and the views of this slot in, the belief
of this slot and the people out. Method: `docs/explanation/estimator.md`; origin of the constants:
the marks above them.
"""

from e3pose.estimate.filter.outlook import outlook as outlook
from e3pose.estimate.filter.state import Belief as Belief
from e3pose.estimate.filter.state import Leftovers as Leftovers
from e3pose.estimate.filter.state import Model as Model
from e3pose.estimate.filter.state import wait_s as wait_s
from e3pose.model.noise import Noise as Noise
