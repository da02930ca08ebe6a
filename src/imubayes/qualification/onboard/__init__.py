"""Constants of a unit for the program that uses them, and recordings corrected with them."""
