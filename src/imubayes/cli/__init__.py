"""The command line: one file per command; each parses, calls and prints, and imports what it needs when it runs."""
