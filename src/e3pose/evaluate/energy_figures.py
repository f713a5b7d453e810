"""Energy and processor time spent by a selection, and what it saved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.energy.profiles import DeviceProfile, Mode, load_profile
from e3pose.energy.queues import mean_watts, paper_percent
from e3pose.energy.saving import Saving, charged, saving
from e3pose.evaluate.figures import CameraEnergy, DeviceSaving, Energy
from e3pose.model.blind_slot import duty as duty_of
from e3pose.model.blind_slot import seeing
from e3pose.recording import Recording

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord

# The devices of the paper, and what 3 of 5 cameras per slot save on each of them: percent of the
# power of CPU, GPU, WiFi and memory, lowest and highest.
PAPER_SAVINGS = {"xavier-nx": (20.66, 31.21), "tx2": (17.72, 28.67)}
PAPER_DUTY = 3 / 5


def modelled_watts(
    records: Sequence[SlotRecord],
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode,
    sends_boxes: bool = False,
    slept_w: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Return `(num_cameras,)` mean power by profiles, and that of an active camera, watts.

    With `sends_boxes` every idle camera sends in each slot that is decided for: its WiFi draws what
    it does in an active slot. `slept_w` `(num_cameras,)` is what sleep took off the mean draw.
    """
    counted = seeing(records)
    duty = duty_of(counted, len(profiles))
    watts = mean_watts(
        duty, profiles, idle_mode, _sending(counted) if sends_boxes and counted else 0.0
    )
    if slept_w is not None:
        watts = watts - slept_w
    return watts, np.array([each.watts("active") for each in profiles])


def charged_watts(
    records: Sequence[SlotRecord],
    charged_j: Floats,
    profiles: Sequence[DeviceProfile],
    interval_s: float,
) -> tuple[Floats, Floats]:
    """Return the same of slots that were stored with the joules they are charged with.

    Args:
        records: one per slot, of which those that are not blind count.
        charged_j: `(num_slots, num_cameras)` joules.
        profiles: `(num_cameras,)` what the cameras draw.
        interval_s: of a slot.
    """
    sees = np.array([not record.blind for record in records])
    selected = np.stack([record.selected for record in records])
    active_j = interval_s * np.array([each.watts("active") for each in profiles])
    spent_j, always_j = charged(selected[sees], charged_j[sees], active_j)
    seconds = max(int(sees.sum()), 1) * interval_s
    return spent_j / seconds, always_j / seconds


def energy_figures(
    recording: Recording,
    records: Sequence[SlotRecord],
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode,
    battery_wh: float | Sequence[float],
    drawn: tuple[Floats, Floats],
    sends_boxes: bool = False,
) -> Energy | None:
    """Return the figures of `docs/explanation/energy.md`; None without a slot, or if all are blind.

    Blind slots are charged as the mean of the others is. `drawn` is mean and active power of each
    camera, watts.
    """
    counted = seeing(records)
    if not counted:
        return None
    watts, active_w = drawn
    batteries_wh = np.broadcast_to(np.asarray(battery_wh, dtype=np.float64), watts.shape)
    duty = float(duty_of(counted, len(watts)).mean())
    sending = float(_sending(counted).mean()) if sends_boxes else 0.0
    seconds = len(records) * recording.interval_s
    return Energy(
        profile=", ".join(dict.fromkeys(each.name for each in profiles)),
        idle_mode=idle_mode,
        watts_spread=float(np.std(watts, ddof=1)) if len(watts) > 1 else 0.0,
        cameras={
            camera_id: CameraEnergy(
                mean_watts=float(watts[n]),
                active_watts=float(active_w[n]),
                energy_j=float(watts[n] * seconds),
                battery_wh=float(batteries_wh[n]),
                battery_hours=float(batteries_wh[n] / watts[n]),
            )
            for n, camera_id in enumerate(recording.rig.camera_ids)
        },
        battery_wh=float(batteries_wh.mean()),
        battery_hours_always_active=float((batteries_wh / active_w).mean()),
        devices={name: _on_device(duty, sending, name) for name in PAPER_SAVINGS},
    )


def _sending(counted: Sequence[SlotRecord]) -> Floats:
    """Return `(num_cameras,)` share of the slots in which a camera is idle, but others look."""
    selected = np.stack([record.selected for record in counted])
    return np.asarray((selected.any(axis=1, keepdims=True) & ~selected).mean(axis=0))


def _on_device(duty: float, sending: float, name: str) -> DeviceSaving:
    """Return what cameras of one kind that are active in a share `duty` of the slots save.

    In a share `sending` of the slots they are idle but send.

    `times_paper` is against the paper's 3 of 5 cameras, both by the same profile.
    """
    profile = load_profile(name)
    modes: tuple[Mode, Mode] = ("power-saving", "aggressive-power-saving")
    idle, aggressive = (paper_percent(duty, profile, mode, sending) for mode in modes)
    paper = paper_percent(PAPER_DUTY, profile)
    return DeviceSaving(idle, aggressive, idle / paper, aggressive / paper)


def processor_saving(
    recording: Recording, records: Sequence[SlotRecord], asleep: Flags | None, idle_mode: Mode
) -> Saving | None:
    """Return what a selection saves of processor time, by looks and frames that were measured.

    Args:
        recording: with `processor`; None unless all cameras have it.
        records: one per slot, of which those that are not blind count.
        asleep: `(num_slots, num_cameras)` who captured nothing; None where everybody is awake.
        idle_mode: what cameras do that are not selected.
    """
    measured = [recording.processor.get(camera_id) for camera_id in recording.rig.camera_ids]
    known = [each for each in measured if each is not None]
    sees = np.array([not record.blind for record in records], dtype=bool)
    if not sees.any() or not known or len(known) < len(measured):
        return None
    look_s = np.array([each.look_s for each in known])
    frame_s = np.array([each.frame_s for each in known])
    looks = np.stack([record.selected for record in records])
    captures = looks if idle_mode == "aggressive-power-saving" else np.ones_like(looks)
    if asleep is not None:
        captures = (captures & ~asleep) | looks
    spent_s = (looks * look_s + captures * frame_s)[sees].sum(axis=0)
    return saving(spent_s, sees.sum() * (look_s + frame_s), measured=False)
