"""The items, in the order of the report."""

from e3pose.reproduce.items import best_subsets, occlusion_error, shelf_table
from e3pose.reproduce.items.base import Item as Item
from e3pose.reproduce.items.base import Scale as Scale

ITEMS: tuple[Item, ...] = (
    best_subsets.ITEM,
    occlusion_error.ITEM,
    shelf_table.ITEM,
)
