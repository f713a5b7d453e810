"""Power: what a camera draws, what a slot of it costs, and what it may spend.

`choose_meter` finds what this machine can measure, `PowerSampler` adds it up, `learn` says what an
active slot costs, `allowance_j` what it may cost.
"""

from e3pose.power.base import Meter, MeterError, Rail, Reading
from e3pose.power.battery import Charge, read_charge
from e3pose.power.budgets import Budget, Supply, allowance_j, parse_budget, slot_shares
from e3pose.power.choose import choose_meter
from e3pose.power.learned import LearnedCost, SlotCost, learn, slot_cost, unlearned
from e3pose.power.ledger import EnergyLedger
from e3pose.power.sampler import PowerSampler, open_sampler
from e3pose.power.site import CameraEnergy, Reckoning, hear, new_camera, reckon

__all__ = [
    "Budget",
    "CameraEnergy",
    "Charge",
    "EnergyLedger",
    "LearnedCost",
    "Meter",
    "MeterError",
    "PowerSampler",
    "Rail",
    "Reading",
    "Reckoning",
    "SlotCost",
    "Supply",
    "allowance_j",
    "choose_meter",
    "hear",
    "learn",
    "new_camera",
    "open_sampler",
    "parse_budget",
    "read_charge",
    "reckon",
    "slot_cost",
    "slot_shares",
    "unlearned",
]
