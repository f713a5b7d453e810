"""Energy spent and saved by a selection, also on the paper's two devices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.energy.profiles import GROUPS, DeviceProfile, Mode, load_profile
from e3pose.energy.queues import savings
from e3pose.evaluate.figures import CameraEnergy, DeviceSaving, Energy, Saving
from e3pose.model.blind_slot import duty as duty_of
from e3pose.model.blind_slot import seeing
from e3pose.recording import Recording

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord

# The devices of the paper, and what 3 of 5 cameras per slot save on each of them: percent of the
# power of CPU, GPU, WiFi and memory, lowest and highest.
PAPER_SAVINGS = {"xavier-nx": (20.66, 31.21), "tx2": (17.72, 28.67)}
PAPER_DUTY = 3 / 5


def energy_figures(
    recording: Recording,
    records: Sequence[SlotRecord],
    profile: DeviceProfile | Sequence[DeviceProfile],
    idle_mode: Mode,
    battery_wh: float | Sequence[float],
    sends_boxes: bool = False,
    slept_w: Floats | None = None,
) -> Energy | None:
    """Return the figures of `docs/explanation/energy.md`; None without a slot, or if all are blind.

    Blind slots are charged as the mean of the others is.

    With `sends_boxes` every idle camera sends in each slot that is decided for: its WiFi draws what
    it does in an active slot. `slept_w` `(num_cameras,)` is what sleep took off the mean draw of
    each; it counts for watts, batteries and the saving of the device.
    """
    counted = seeing(records)
    if not counted:
        return None
    duty = duty_of(counted, len(recording.rig))
    selected = np.stack([record.selected for record in counted])
    decided = selected.any(axis=1, keepdims=True) & ~selected
    sending = decided.mean(axis=0) if sends_boxes else np.zeros(len(duty))
    profiles = [profile] * len(duty) if isinstance(profile, DeviceProfile) else list(profile)
    batteries_wh = np.broadcast_to(np.asarray(battery_wh, dtype=np.float64), duty.shape)
    saved = savings(duty, profiles, idle_mode, batteries_wh, sending)
    if slept_w is not None:
        active_w = np.array([each.watts("active") for each in profiles])
        saved = saved.with_sleep(slept_w, active_w, batteries_wh)
    seconds = len(records) * recording.interval_s
    return Energy(
        profile=", ".join(dict.fromkeys(each.name for each in profiles)),
        idle_mode=idle_mode,
        saving_percent=saved.paper_percent,
        device_saving_percent=saved.device_percent,
        watts_spread=float(np.std(saved.camera_watts, ddof=1)) if len(duty) > 1 else 0.0,
        components={
            group: Saving(saved.group_percent[group])
            for group in GROUPS
            if group in saved.group_percent
        },
        cameras={
            camera_id: CameraEnergy(
                saving_percent=float(saved.camera_percent[n]),
                mean_watts=float(saved.camera_watts[n]),
                active_watts=profiles[n].watts("active"),
                energy_j=float(saved.camera_watts[n] * seconds),
                battery_wh=float(batteries_wh[n]),
                battery_hours=float(saved.battery_h[n]),
            )
            for n, camera_id in enumerate(recording.rig.camera_ids)
        },
        battery_wh=float(batteries_wh.mean()),
        battery_hours_always_active=saved.battery_active_h,
        devices={
            name: _on_device(float(duty.mean()), float(sending.mean()), name)
            for name in PAPER_SAVINGS
        },
    )


def _on_device(duty: float, sending: float, name: str) -> DeviceSaving:
    """Return what cameras of one kind that are active in a share `duty` of the slots save.

    In a share `sending` of the slots they are idle but send.

    `times_paper` is against the paper's 3 of 5 cameras, both by the same profile.
    """
    profile = load_profile(name)
    modes: tuple[Mode, Mode] = ("power-saving", "aggressive-power-saving")
    saving, aggressive = (
        savings([duty], profile, mode, sending=sending).paper_percent for mode in modes
    )
    paper = savings([PAPER_DUTY], profile).paper_percent
    return DeviceSaving(saving, aggressive, saving / paper, aggressive / paper)
