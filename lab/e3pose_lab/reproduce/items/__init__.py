"""The items, in the order of the report."""

from e3pose_lab.reproduce.items import (
    batteries,
    best_subsets,
    device_power,
    frame_rate,
    frontier,
    live_video,
    memory,
    occlusion_error,
    occlusion_prediction,
    panoptic_table,
    pizza_table,
    scene,
    shelf_table,
    site_power,
    trade_offs,
)
from e3pose_lab.reproduce.items.base import Item as Item
from e3pose_lab.reproduce.items.base import Scale as Scale

ITEMS: tuple[Item, ...] = (
    device_power.ITEM,
    scene.ITEM,
    best_subsets.ITEM,
    occlusion_error.ITEM,
    shelf_table.ITEM,
    pizza_table.ITEM,
    panoptic_table.ITEM,
    site_power.ITEM,
    live_video.ITEM,
    occlusion_prediction.ITEM,
    trade_offs.ITEM,
    memory.ITEM,
    frame_rate.ITEM,
    batteries.ITEM,
    frontier.ITEM,
)
