"""Constants of a unit for the program that uses them, and recordings corrected with them."""

from typing import Literal

Format = Literal["json", "c", "kalibr", "px4", "ardupilot", "ros"]
"""Formats of the constants."""
