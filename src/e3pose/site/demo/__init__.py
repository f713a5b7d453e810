"""The demo: a live site on a real clip or a simulated scene."""

from e3pose.site.demo.job import run_demo as run_demo
from e3pose.site.demo.summary import DemoReport as DemoReport
from e3pose.site.demo.summary import printed_lines as printed_lines
