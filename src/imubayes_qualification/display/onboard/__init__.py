"""Constants for use on board in the formats of other programs."""
