"""The hub: one place that keeps the summaries of many sites, and answers questions about them."""

__version__ = "0.1.0"
